"""Offset of the clocks of torque and motion: t0 d(tau_s)/dt + t1 F d(tau_load)/dt, one of each per recording.

F is the high-frequency part, less informative because of its noise.

Torques of drives are computed from set-point and position of one instant: they have no offset. Their delay is that of
the set-points alone, which the mapping states. An offset would absorb rotor inertia and viscous friction.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from torch import Tensor

from torchrbd.dataset.rows import Rows
from torchrbd.effects import Signals
from torchrbd.effects.band_limits import below
from torchrbd.nuisance.component import Along, Component, Learnt, nothing

OFFSET_HZ = 6.0
"""Frequency below which derivatives of the load count as slow [Hz]: above, noise of the positions dominates them."""
# Prior standard deviation of the offset, in samples.
_STD_SAMPLES = 3.0


class ClockOffset(Component):
    """How much later the torque of each recording is than its motion.

    Args:
        rows: the data.

    Attributes:
        std: prior standard deviation [s].
    """

    local = False

    def __init__(self, rows: Rows) -> None:
        self._inside = np.array([rows.recording == k for k in np.unique(rows.recording)])
        self._noise_share, self.std, self._driven = rows.noise_share, _STD_SAMPLES * rows.dt, bool(rows.driven.any())
        self.n = 2 * len(self._inside)

    @property
    def index(self) -> np.ndarray:
        """Indices of the offsets, one per recording."""
        return self.first + np.arange(len(self._inside))

    def at(self, joint: int) -> np.ndarray:
        return self.first + np.arange(self.n)

    def along(self) -> Mapping[str, Callable[[Signals], Tensor]]:
        return {"rate": lambda signals: signals.rate(signals.supplied), "fast rate of load": fast_rate_of_load}

    def columns(self, joint: int, learnt: Learnt, along: Along | None) -> tuple[np.ndarray, np.ndarray]:
        if along is None or self._driven:
            return nothing(self._inside.shape[1])
        fast = self.std * self._noise_share[joint] * along["fast rate of load"][joint]
        return np.concatenate((self.std * along["rate"][joint] * self._inside, fast * self._inside)), self.at(joint)


def fast_rate_of_load(signals: Signals) -> Tensor:
    """Return the high-frequency part of the rate of the load, (n, N) [N m/s or N/s]."""
    t, rate = signals.sequence(), signals.rate(signals.load)
    return rate - below(rate, float(t[1] - t[0]), OFFSET_HZ)
