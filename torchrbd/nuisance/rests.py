"""Where joints rest, or reverse: smoothed positions do not show the direction there."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import maximum_filter1d

from torchrbd.dataset.rows import Rows
from torchrbd.nuisance.directions import RESTS, Directions

# The velocity's error is multiplied by this; only the longest rests per joint have terms of their own.
_STICK, _MOST = 3.0, 30
# Reach of a rest's effect [rows].
_FELT_ROWS = 6


class Rests:
    """Rests of all joints.

    Args:
        rows: the data.
        directions: of the motion.

    Attributes:
        of: per joint, the uncertainty of its direction rest by rest (E, M).
        around: per joint, which rows belong to each rest, neighbouring ones too, (E, M) bool.
        breaking: (M,) 1 where any joint breaks away, else 0.
    """

    def __init__(self, rows: Rows, directions: Directions) -> None:
        unsure = directions.unsure[_STICK]
        self.of = [_rests(u, rows.run) for u in unsure]
        self.around = [_near(rests) for rests in self.of]
        self.breaking = maximum_filter1d(np.any(unsure > RESTS, axis=0).astype(float), 2 * _FELT_ROWS + 1)


def _rests(u: np.ndarray, run: np.ndarray) -> np.ndarray:
    """Return the uncertainty u (M,) of the direction of a joint's motion, rest by rest, (E, M)."""
    still = u > RESTS
    begins = still & ~np.concatenate(([False], still[:-1] & (np.diff(run) == 0)))
    number = np.where(still, np.cumsum(begins), 0)
    lengths = np.bincount(number, weights=u**2)[1:]
    kept = np.sort(np.argsort(-lengths)[:_MOST]) + 1
    return np.array([np.where(number == k, u, 0.0) for k in kept]).reshape(len(kept), len(u))


def _near(rests: np.ndarray) -> np.ndarray:
    """Return which rows belong to each of E rests (E, M), including neighbouring rows, each row to one at most."""
    weight = np.array([maximum_filter1d(rest, 2 * _FELT_ROWS + 1) + rest for rest in rests]).reshape(rests.shape)
    return (weight > 0) & (np.arange(len(rests))[:, None] == weight.argmax(0)) if len(rests) else weight
