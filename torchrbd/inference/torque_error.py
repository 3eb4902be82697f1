"""How well a model predicts torque: what fits are judged by, and results report."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

# Squared error over variance from which on a prediction is no better than one in other units.
_ABSURD = 100.0


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
