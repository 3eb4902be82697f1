"""A delay of the loads' high-frequency part of each joint's own: t_j b F d(tau_load)/dt, b = 1 where any breaks away.

When a joint breaks away, smoothed positions do not show it. The high-frequency part of all loads then seems to have a
delay, which is not that of the clocks.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from torch import Tensor

from torchrbd.dataset.rows import Rows
from torchrbd.effects import Signals
from torchrbd.nuisance.clock_offset import fast_rate_of_load
from torchrbd.nuisance.component import Along, Learnt, OfEachJoint, nothing
from torchrbd.nuisance.rests import Rests


class Breakaway(OfEachJoint):
    """The delay of each joint where any joint breaks away.

    Args:
        rows: the data.
        rests: of all joints.
        std: prior standard deviation of the delay [s].
    """

    def __init__(self, rows: Rows, rests: Rests, std: float) -> None:
        super().__init__(rows.n_dof, 1)
        self._breaking, self._noise_share, self._std = rests.breaking, rows.noise_share, std

    def along(self) -> Mapping[str, Callable[[Signals], Tensor]]:
        return {"fast rate of load": fast_rate_of_load}

    def columns(self, joint: int, learnt: Learnt, along: Along | None) -> tuple[np.ndarray, np.ndarray]:
        if along is None:
            return nothing(len(self._breaking))
        fast = self._std * self._noise_share[joint] * along["fast rate of load"][joint]
        return (self._breaking * fast)[None], self.at(joint)
