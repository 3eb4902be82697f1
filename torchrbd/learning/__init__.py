"""Models for learning pipelines."""

from typing import TYPE_CHECKING

from torchrbd.learning.bayesian_dynamics import BayesianDynamics
from torchrbd.learning.coordinates import physics_columns
from torchrbd.learning.fit_residual import Training, fit_residual
from torchrbd.learning.many_robots import ManyRobots
from torchrbd.learning.natural_gradient import NaturalGradient
from torchrbd.learning.parameter_groups import parameter_groups
from torchrbd.learning.physics_metric import PhysicsMetric
from torchrbd.learning.predictions import ExternalTorque, Prediction
from torchrbd.learning.residual_data import ResidualDataset, residual_dataset
from torchrbd.learning.residual_dynamics import ResidualDynamics, TorqueShares

if TYPE_CHECKING:
    from torchrbd.learning.dynamics_regressor import DynamicsRegressor

__all__ = [
    "BayesianDynamics",
    "DynamicsRegressor",
    "ExternalTorque",
    "ManyRobots",
    "NaturalGradient",
    "PhysicsMetric",
    "Prediction",
    "ResidualDataset",
    "ResidualDynamics",
    "TorqueShares",
    "Training",
    "fit_residual",
    "parameter_groups",
    "physics_columns",
    "residual_dataset",
]


def __getattr__(name: str) -> object:
    """Import the one name for which scikit-learn must be imported, which takes a second."""
    if name != "DynamicsRegressor":
        raise AttributeError(f"module 'torchrbd.learning' has no attribute '{name}'")
    from torchrbd.learning.dynamics_regressor import DynamicsRegressor

    return DynamicsRegressor
