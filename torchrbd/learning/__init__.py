"""Models for learning pipelines."""

from torchrbd.learning.bayesian_dynamics import BayesianDynamics, ExternalTorque, Prediction
from torchrbd.learning.dynamics_regressor import DynamicsRegressor
from torchrbd.learning.many_robots import ManyRobots

__all__ = ["BayesianDynamics", "DynamicsRegressor", "ExternalTorque", "ManyRobots", "Prediction"]
