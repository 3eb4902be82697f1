from torchrbd.comparison import Comparison, compare
from torchrbd.diagnosis import Diagnosis, Finding, Ranking, diagnose, rank_hypotheses
from torchrbd.effects import known_effects, register
from torchrbd.errors import InputError, OptionError, PhysicalError, RecordingError, RobotError, TorchRBDError
from torchrbd.excitation import Excitation, excite
from torchrbd.export import load_model, not_exported, save_model, to_actuator_net, to_mjcf, to_urdf
from torchrbd.inference import (
    BaseRegression,
    EstimatorComparison,
    Identification,
    Replay,
    Settings,
    compare_estimators,
    identify,
    identify_many,
    merge_statistics,
    replay,
    write_statistics,
)
from torchrbd.learning import (
    BayesianDynamics,
    DynamicsRegressor,
    NaturalGradient,
    ResidualDynamics,
    fit_residual,
    parameter_groups,
    residual_dataset,
)
from torchrbd.model import RigidBodyDynamics
from torchrbd.recordings import Recording, open_recording, read_mapping
from torchrbd.report import write_report, write_results
from torchrbd.robot import RobotModel
from torchrbd.simulation import SimulatedMotion, simulate

__version__: str

__all__ = [
    "BaseRegression",
    "BayesianDynamics",
    "Comparison",
    "Diagnosis",
    "DynamicsRegressor",
    "EstimatorComparison",
    "Excitation",
    "Finding",
    "Identification",
    "InputError",
    "NaturalGradient",
    "OptionError",
    "PhysicalError",
    "Ranking",
    "Recording",
    "RecordingError",
    "Replay",
    "ResidualDynamics",
    "RigidBodyDynamics",
    "RobotError",
    "RobotModel",
    "Settings",
    "SimulatedMotion",
    "TorchRBDError",
    "compare",
    "compare_estimators",
    "diagnose",
    "excite",
    "fit_residual",
    "identify",
    "identify_many",
    "known_effects",
    "load_model",
    "merge_statistics",
    "not_exported",
    "open_recording",
    "parameter_groups",
    "rank_hypotheses",
    "read_mapping",
    "register",
    "replay",
    "residual_dataset",
    "save_model",
    "simulate",
    "to_actuator_net",
    "to_mjcf",
    "to_urdf",
    "write_report",
    "write_results",
    "write_statistics",
]
