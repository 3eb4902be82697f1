"""Models for learning pipelines."""

from typing import TYPE_CHECKING

from torchrbd.learning.bayesian_dynamics import BayesianDynamics
from torchrbd.learning.many_robots import ManyRobots
from torchrbd.learning.predictions import ExternalTorque, Prediction

if TYPE_CHECKING:
    from torchrbd.learning.dynamics_regressor import DynamicsRegressor

__all__ = ["BayesianDynamics", "DynamicsRegressor", "ExternalTorque", "ManyRobots", "Prediction"]


def __getattr__(name: str) -> object:
    """Import the one name for which scikit-learn must be imported, which takes a second."""
    if name != "DynamicsRegressor":
        raise AttributeError(f"module 'torchrbd.learning' has no attribute '{name}'")
    from torchrbd.learning.dynamics_regressor import DynamicsRegressor

    return DynamicsRegressor
