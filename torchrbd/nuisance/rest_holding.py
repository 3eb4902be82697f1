"""Friction at each rest: h sum_e (sum_k h_ek u_e(t) cos(k pi s_e) / (1 + k) + t_e dg/dt), s_e from 0 to 1 during it.

At each rest or reversal e, friction is an unknown torque within its limits (h, at least as large as in motion): one
unknown for a reversal, several for a long rest. The time of its change is known to a fraction of a sample (t_e).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import numpy as np
from torch import Tensor

from torchrbd.dataset.rows import Rows
from torchrbd.effects import Signals
from torchrbd.nuisance.component import Along, Component, Learnt, nothing
from torchrbd.nuisance.directions import turning
from torchrbd.nuisance.rests import Rests

# Highest frequency of the friction in a long rest [Hz]; largest number of such unknowns per joint.
_HOLDS_HZ, _MOST_HOLDS = 5.0, 60
# Standard deviation of the time at which friction changes, in samples.
_TURNS_SAMPLES = 0.5


class RestHolding(Component):
    """Friction at each rest of each joint, then the times of its change.

    Args:
        rows: the data.
        rests: of all joints.

    Attributes:
        ways: per joint, functions of time for friction during rests (H, M), the slowest ones first.
    """

    def __init__(self, rows: Rows, rests: Rests) -> None:
        self._rows, self.rests = rows, rests
        self.ways = [_ways(each, rows.dt_out) for each in rests.of]
        both = zip(self.ways, rests.around, strict=True)
        self._ends = np.cumsum([0, *(len(ways) + len(around) for ways, around in both)])
        self.n = int(self._ends[-1])

    def at(self, joint: int) -> np.ndarray:
        return self.first + np.arange(self._ends[joint], self._ends[joint + 1])

    def holding(self, joint: int) -> np.ndarray:
        """Return the indices of the friction at each of a joint's rests."""
        return self.at(joint)[: len(self.ways[joint])]

    def along(self) -> Mapping[str, Callable[[Signals], Tensor]]:
        return {"turning": turning}

    def columns(self, joint: int, learnt: Learnt, along: Along | None) -> tuple[np.ndarray, np.ndarray]:
        if along is None:
            return nothing(len(self._rows.t))
        turns = _TURNS_SAMPLES * self._rows.dt * along["turning"][joint] * self.rests.around[joint]
        return np.concatenate((self.ways[joint], turns)), self.at(joint)

    def sizes(self, joint: int, own: np.ndarray, learnt: Learnt) -> np.ndarray:
        return np.full(len(own), learnt.held[joint])


def _ways(rests: np.ndarray, dt: float) -> np.ndarray:
    """Return functions of time for friction during rests (E, M), the slowest ones first, (H, M).

    During a rest friction is a random walk: its cosines are smaller the faster they are.
    """
    found: list[tuple[int, int, np.ndarray]] = []
    for rest in rests:
        at = np.flatnonzero(rest)
        passed = np.linspace(0.0, math.pi, len(at))
        for order in range(1 + int(2.0 * _HOLDS_HZ * len(at) * dt)):
            way = np.zeros(len(rest))
            way[at] = rest[at] * np.cos(order * passed) / (1 + order)
            found.append((order, -len(at), way))
    kept = sorted(found, key=lambda one: one[:2])[:_MOST_HOLDS]
    return np.array([way for *_, way in kept]).reshape(len(kept), rests.shape[1])
