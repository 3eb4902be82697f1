"""Torques with their uncertainty."""

from __future__ import annotations

from typing import NamedTuple

from scipy.stats import norm
from torch import Tensor


class Prediction(NamedTuple):
    """A torque and how sure it is, [N m] or [N].

    Attributes:
        mean: (*batch, n_dof).
        parameter_std: (*batch, n_dof) from what is not known of the parameters.
        noise_std: (n_dof,) of what the model does not explain of a measured torque.
    """

    mean: Tensor
    parameter_std: Tensor
    noise_std: Tensor

    @property
    def std(self) -> Tensor:
        """Of a torque that is measured, (*batch, n_dof)."""
        return (self.parameter_std.square() + self.noise_std.square()).sqrt()

    def interval(self, probability: float = 0.95) -> tuple[Tensor, Tensor]:
        """Return the ends of an interval that holds a measured torque with this probability."""
        width = float(norm.ppf(0.5 + 0.5 * probability)) * self.std
        return self.mean - width, self.mean + width


class ExternalTorque(NamedTuple):
    """What a measured torque has beyond the model's, [N m] or [N].

    Attributes:
        torque, std: (*batch, n_dof), and its standard deviation where nothing touches the robot.
        touched: (*batch, n_dof) whether it is out of the band of that.
    """

    torque: Tensor
    std: Tensor
    touched: Tensor
