"""Inputs of a network that corrects the physics: angles as sine and cosine, rates and history, in the data's spread.

One sample's features are all joints' q, then qd, then qdd. Then, for each of h steps back (the present one first), come
all joints' position errors q_ref - q and velocities: (3 + 2 h) n numbers, in SI units.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from torchrbd.errors import InputError
from torchrbd.robot import RobotModel

# Of a signal that hardly changes in the data [rad, m, and per second ...]: less than that is no change.
_LEAST_STD = 1e-4


def n_features(n_dof: int, history: int) -> int:
    """Return how many features a sample has."""
    return (3 + 2 * history) * n_dof


class Encoder(nn.Module):
    """Features to network inputs, ``z = (e(x) - mean) / std`` with e(x) = [sin q, cos q | q if prismatic, rest].

    Args:
        robot: whose joints they are.
        history: steps back, the present one among them.

    Attributes:
        mean, std: (n_inputs,) of e(x) in the data; 0 and 1 before ``calibrate``.
        n_positions: how many inputs, the first ones, are made of q alone.
    """

    mean: Tensor
    std: Tensor

    def __init__(self, robot: RobotModel, history: int) -> None:
        super().__init__()
        self.n_dof, self.history = robot.n_dof, history
        slides = robot.prismatic.tolist()
        self._turning = [j for j, slide in enumerate(slides) if not slide]
        self._sliding = [j for j, slide in enumerate(slides) if slide]
        self.n_positions = 2 * len(self._turning) + len(self._sliding)
        size = self.n_positions + (2 + 2 * history) * self.n_dof
        self.register_buffer("mean", torch.zeros(size, dtype=torch.float64))
        self.register_buffer("std", torch.ones(size, dtype=torch.float64))

    @property
    def n_inputs(self) -> int:
        """Size of what ``forward`` returns."""
        return len(self.mean)

    def forward(self, features: Tensor) -> Tensor:
        """Return inputs (*batch, n_inputs) of features (*batch, (3 + 2 h) n).

        Raises:
            InputError: another number of features.
        """
        self.check(features)
        raw = torch.cat((self._positions(features[..., : self.n_dof]), features[..., self.n_dof :]), -1)
        return (raw - self.mean.to(features)) / self.std.to(features)

    def of_positions(self, q: Tensor) -> Tensor:
        """Return the first ``n_positions`` inputs of positions q (*batch, n)."""
        own = slice(self.n_positions)
        return (self._positions(q) - self.mean[own].to(q)) / self.std[own].to(q)

    def calibrate(self, features: Tensor) -> None:
        """Take mean and spread from features (N, (3 + 2 h) n) of data."""
        self.check(features)
        self.mean.zero_()
        self.std.fill_(1.0)
        raw = self(features.to(self.mean))
        self.mean.copy_(raw.mean(0))
        self.std.copy_(raw.std(0, correction=0).clamp_min(_LEAST_STD))

    def check(self, features: Tensor) -> None:
        """Raise InputError where features are of another size."""
        expected = n_features(self.n_dof, self.history)
        if features.ndim < 1 or features.shape[-1] != expected:
            raise InputError(
                f"features have shape {tuple(features.shape)}; expected (..., {expected}): q, qd, qdd of "
                f"{self.n_dof} joints and {self.history} step(s) of history"
            )

    def _positions(self, q: Tensor) -> Tensor:
        turning = q[..., self._turning]
        return torch.cat((turning.sin(), turning.cos(), q[..., self._sliding]), -1)
