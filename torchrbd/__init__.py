"""Find, name and model the physics that a robot's URDF leaves out.

import torchrbd
diagnosis = torchrbd.diagnose("robot.urdf", ["recording.csv"])
model = diagnosis.identification.model          # an nn.Module: tau = model(q, qd, qdd)

Importing torchrbd costs nothing: what stands here is imported when it is first asked for.
"""

from importlib import import_module

from torchrbd.display import Displayed, Stated

# Where the public names live; ``__init__.pyi`` says the same to type checkers, and a test compares the two.
_NAMES = {
    "comparison": ("Comparison", "compare"),
    "diagnosis": ("Diagnosis", "Finding", "Ranking", "diagnose", "rank_hypotheses"),
    "errors": ("InputError", "OptionError", "PhysicalError", "RecordingError", "RobotError", "TorchRBDError"),
    "excitation": ("Excitation", "excite"),
    "export": ("load_model", "save_model", "to_actuator_net", "to_mjcf", "to_urdf", "not_exported"),
    "inference": (
        "BaseRegression",
        "EstimatorComparison",
        "Identification",
        "Replay",
        "Settings",
        "compare_estimators",
        "identify",
        "identify_many",
        "merge_statistics",
        "replay",
        "write_statistics",
    ),
    "learning": (
        "BayesianDynamics",
        "DynamicsRegressor",
        "NaturalGradient",
        "ResidualDynamics",
        "fit_residual",
        "parameter_groups",
        "residual_dataset",
    ),
    "model": ("RigidBodyDynamics",),
    "parameters": (),
    "effects": ("known_effects", "register"),
    "recordings": ("Recording", "open_recording", "read_mapping"),
    "report": ("write_report", "write_results"),
    "robot": ("RobotModel",),
    "simulation": ("SimulatedMotion", "simulate"),
}
_ROOM_OF = {name: room for room, names in _NAMES.items() for name in names}

__all__ = sorted(_ROOM_OF)  # pyright: ignore[reportUnsupportedDunderAll]


def _card(result: object) -> str:
    return import_module("torchrbd.report.notebook").card(result)


def _in_words(result: object) -> str:
    return import_module("torchrbd.report.text").in_words(result)


# Results come before the report in the order of imports: who draws and says them is set here.
Displayed.card, Stated.in_words = staticmethod(_card), staticmethod(_in_words)


def _version() -> str:
    """Return the installed version, which comes from the repository's tags; of a bare source tree none is known."""
    metadata = import_module("importlib.metadata")
    try:
        return metadata.version("torchrbd")
    except metadata.PackageNotFoundError:
        return "0.0.0+source"


def __getattr__(name: str) -> object:
    """Import a public name, or a room such as ``torchrbd.effects``, on first use (PEP 562)."""
    if name in _NAMES:
        return import_module(f"torchrbd.{name}")
    if name == "__version__":
        found = globals()[name] = _version()
        return found
    if name not in _ROOM_OF:
        raise AttributeError(f"module 'torchrbd' has no attribute '{name}'")
    found = globals()[name] = getattr(import_module(f"torchrbd.{_ROOM_OF[name]}"), name)
    return found


def __dir__() -> list[str]:
    return sorted({*globals(), "__version__", *_ROOM_OF, *_NAMES})
