"""Drift of each joint's torque: the lowest frequencies of a random walk, and its level.

The level is no larger than the drift: a larger one is an offset.
"""

from __future__ import annotations

import math

import numpy as np

from torchrbd.dataset.rows import Rows
from torchrbd.nuisance.component import Along, Learnt, OfEachJoint

DRIFT_HZ, MOST_DRIFT = 0.1, 12
"""Highest frequency of drift [Hz], and largest number of its cosines per recording."""


class Drift(OfEachJoint):
    """Cosines of time of each recording.

    Args:
        rows: the data.
    """

    def __init__(self, rows: Rows) -> None:
        self._basis, self._order = drift_basis(rows.t, rows.recording, DRIFT_HZ, MOST_DRIFT)
        super().__init__(rows.n_dof, len(self._basis))

    def wandering(self, joint: int) -> np.ndarray:
        """Return the indices of a joint's drift without its levels, which may be an offset."""
        return self.at(joint)[self._order > 0]

    def columns(self, joint: int, learnt: Learnt, along: Along | None) -> tuple[np.ndarray, np.ndarray]:
        return self._basis, self.at(joint)

    def sizes(self, joint: int, own: np.ndarray, learnt: Learnt) -> np.ndarray:
        return learnt.drift[joint] / np.maximum(self._order[own - self.at(joint)[0]], 1)


def drift_basis(t: np.ndarray, recording: np.ndarray, slowest_hz: float, most: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the lowest frequencies of each recording, from its level on, as a basis for drift.

    Args:
        t: (M,) seconds.
        recording: (M,) number.
        slowest_hz: the highest frequency that counts as drift [Hz].
        most: largest number of functions per recording.

    Returns:
        cosines (D, M), zero outside of their recording, and their orders (D,), 0 for the level.
    """
    functions, orders = [], []
    for k in np.unique(recording):
        inside = recording == k
        begin, length = t[inside].min(), max(float(np.ptp(t[inside])), 1e-9)
        for order in range(min(most, max(1, int(2 * length * slowest_hz))) + 1):
            functions.append(np.where(inside, np.cos(math.pi * order * (t - begin) / length), 0.0))
            orders.append(order)
    return np.array(functions), np.array(orders)
