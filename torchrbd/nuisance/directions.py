"""The direction of each joint's motion, g = tanh(qd / w), and where smoothed positions cannot show it."""

from __future__ import annotations

import math
from functools import partial

import numpy as np
import torch
from scipy.special import ndtri
from torch import Tensor

from torchrbd.dataset.resting import moving
from torchrbd.dataset.rows import Rows
from torchrbd.effects import Signals

STICKS = (1.0, 3.0, 10.0)
"""A joint counts as sticking below these multiples of its velocity's error: it creeps, and its friction is unknown."""
RESTS = 0.05
"""A joint rests, or reverses, where its direction is this uncertain."""
# Its speed is then below this, in standard deviations of its error: 2 sqrt(p (1 - p)) = r for p = (1 - sqrt(1 - r^2)) /
# 2.
_SLOW = -float(ndtri(0.5 * (1.0 - math.sqrt(1.0 - RESTS**2))))
# Number of cached widths of sign changes, the most recent ones.
_MOST_CACHED = 256


class Directions:
    """Directions of motion at the rows.

    Args:
        rows: the data.

    Attributes:
        moving: (n_dof,) joints that ever move; the others have no columns from their own motion.
        unsure: by stick, the standard deviation of sign(qd), (n, M).
    """

    def __init__(self, rows: Rows) -> None:
        self.moving = moving(rows.qd, rows.block, rows.columns.slow.numpy())
        self.unsure = {k: rows.evaluated(partial(self._std, rows.speed_std, k)) for k in STICKS}
        self._rows, self._known = rows, dict[tuple[int, float], np.ndarray]()

    @staticmethod
    def _std(speed_std: np.ndarray, stick: float, signals: Signals) -> Tensor:
        """Return the standard deviation of sign(qd), (n, N): 2 sqrt(p (1 - p)), p the probability that it is wrong."""
        std = torch.from_numpy(np.maximum(stick * speed_std, 1e-300))
        p = torch.special.ndtr(-signals.qd.abs() / std.unsqueeze(1))
        return 2.0 * (p * (1.0 - p)).sqrt()

    def sign(self, joint: int, width: float) -> np.ndarray:
        """Return max(g, 0) and min(g, 0), (2, M), of g = tanh(qd / width)."""
        return self._evaluated(joint, width)[:2]

    def held(self, joint: int, width: float) -> np.ndarray:
        """Return g' - g, (3, M): g' is g = tanh(qd / width), with straight lines wherever the joint may rest.

        The three columns differ in the speed below which it may rest, see ``STICKS``.
        """
        return self._evaluated(joint, width)[2:]

    def _evaluated(self, joint: int, width: float) -> np.ndarray:
        def directions(signals: Signals) -> Tensor:
            qd = signals.qd[joint] * float(self.moving[joint])
            g = torch.tanh(qd / width)
            # Where the direction is this uncertain, as in ``unsure``.
            unsure = (qd.abs() < _SLOW * stick * max(self._rows.speed_std[joint], 1e-300) for stick in STICKS)
            lines = [_straight(g.numpy(), rests.numpy()) - g.numpy() for rests in unsure]
            return torch.stack((g.clamp_min(0.0), g.clamp_max(0.0), *map(torch.from_numpy, lines)))

        found = self._known.pop((joint, width), None)
        if found is None:
            found = self._rows.evaluated(directions)
            if len(self._known) >= _MOST_CACHED:
                del self._known[next(iter(self._known))]
        self._known[joint, width] = found
        return found


def _straight(g: np.ndarray, rests: np.ndarray) -> np.ndarray:
    """Return a signal (N,) with straight lines where it is at rest (N,) bool."""
    at = np.arange(len(g))
    return np.interp(at, at[~rests], g[~rests]) if not rests.all() else g


def turning(signals: Signals) -> Tensor:
    """Return the rate of the direction of Coulomb friction, (n, N) [1/s]."""
    return signals.rate(signals.directions)
