"""Models for learning pipelines."""

from torchrbd.learning.dynamics_regressor import DynamicsRegressor
from torchrbd.learning.fit_residual import Training, fit_residual
from torchrbd.learning.physics_metric import PhysicsMetric, physics_columns
from torchrbd.learning.residual_data import ResidualDataset, residual_dataset
from torchrbd.learning.residual_dynamics import ResidualDynamics, TorqueShares

__all__ = [
    "DynamicsRegressor",
    "PhysicsMetric",
    "ResidualDataset",
    "ResidualDynamics",
    "TorqueShares",
    "Training",
    "fit_residual",
    "physics_columns",
    "residual_dataset",
]
