"""Estimators of a robot's parameters: those of the robot field, and every plain regression applied to robots."""

from torchrbd.inference.estimators.estimate import Estimate, estimate, estimators
from torchrbd.inference.estimators.problem import LinearProblem, linear_problem

__all__ = ["Estimate", "LinearProblem", "estimate", "estimators", "linear_problem"]
