"""Models for learning pipelines."""

from torchrbd.learning.dynamics_regressor import DynamicsRegressor

__all__ = ["DynamicsRegressor"]
