"""How well a model predicts torque: what fits are judged by, and results report."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

# Squared error over variance from which on a prediction is no better than one in other units.
_ABSURD = 100.0
# A torque whose variance is a smaller part of its mean square is constant.
_LEAST_VARIANCE = 1e-12


@dataclass(frozen=True)
class Fit:
    """How well one model predicts the torque of blocks that no fit has seen.

    Attributes:
        nmse: per joint, mean squared error / variance of the measured torque, both on held-out blocks, [-].
        rmse: per joint, root mean squared error, [N m] or [N].
    """

    nmse: dict[str, float]
    rmse: dict[str, float]

    @property
    def absurd(self) -> tuple[str, ...]:
        """Joints whose torque is more than ten times off: units or columns are wrong, and no gain over it counts."""
        return tuple(joint for joint, value in self.nmse.items() if value > _ABSURD)

    @property
    def mean_nmse(self) -> float:
        """Mean over the joints that have one, every joint counted once."""
        finite = [value for value in self.nmse.values() if np.isfinite(value)]
        return float(np.mean(finite)) if finite else np.nan


def torque_fit(joints: Sequence[str], measured: np.ndarray, predicted: np.ndarray) -> Fit:
    """Return how well torques (M, n) are predicted, every row counting alike.

    Joints whose torque is missing (NaN) or constant are left out.

    Args:
        joints: names (n,).
        measured, predicted: band-limited alike [N m] or [N].
    """
    nmse, rmse = dict[str, float](), dict[str, float]()
    for j, joint in enumerate(joints):
        seen = np.isfinite(measured[:, j])
        if not seen.any():
            continue
        tau, error = measured[seen, j], (measured - predicted)[seen, j]
        variance, square = float(np.var(tau)), float(np.mean(error**2))
        if variance > _LEAST_VARIANCE * float(np.mean(tau**2)):
            nmse[joint], rmse[joint] = square / variance, float(np.sqrt(square))
    return Fit(nmse, rmse)
