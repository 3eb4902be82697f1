"""Correction of the fastest part of each joint's motion, in the torques of all joints:

    sum_k dtau/dq_k s + dtau/dqd_k s' + dtau/dqdd_k s'',   s = a_k d^2q_k/dt^2 + b_k d^4q_k/dt^4

The fastest part of the differentiated positions is both motion and encoder noise. The torques of all joints identify
the share of motion, joint by joint: q + a d^2q/dt^2 is q with its highest frequencies attenuated (regression
calibration: Carroll et al., "Measurement Error in Nonlinear Models", 2006, ch. 4). The states' filter has one gain W(f)
for all time and for each joint alone: the motion's mean share of the power. But near the band's edge motion comes in
bursts. When dry friction reverses, it accelerates all joints at once for some hundredths of a second; between reversals
there is only noise. The gain that fits the rows differs from W by an even function of the frequency; a and b are its
first two terms. With a alone, the error of W was taken for an elasticity of the transmission, which amplifies high
frequencies and has both terms: 156 nats for one that did not exist. There were none without friction, and none without
noise in the positions. W does not change slow motion, so a and b do not either.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping

import numpy as np
import torch
from torch import Tensor

from torchrbd.dataset.rows import Rows
from torchrbd.effects import Signals
from torchrbd.effects.band_limits import flat_below
from torchrbd.nuisance.component import Along, Component, Learnt, nothing

# Rows per period of the band's edge; fraction of that edge above which motion is fast; number of gain terms; least gain
# of the states' filter that counts.
_EDGE_ROWS, _FAST, _TERMS, _LEAST_GAIN = 2.5, 0.25, 2, 0.1


class StateBandwidth(Component):
    """a of each joint, then b.

    Args:
        rows: the data.
    """

    local = False

    def __init__(self, rows: Rows) -> None:
        self.n, self._rows = _TERMS * rows.n_dof, rows
        # 1 / W - 1, with W at the band's edge.
        noise = np.tile(rows.noise_share, _TERMS)
        self._std = noise / np.maximum(1.0 - noise, _LEAST_GAIN)

    def at(self, joint: int) -> np.ndarray:
        return self.first + np.arange(self.n)

    def along(self) -> Mapping[str, Callable[[Signals], Tensor]]:
        return {"fastest": self._deviations}

    def _deviations(self, signals: Signals) -> Tensor:
        """Return the torques (2 n, n, N) of each joint's fastest motion, d^2q/dt^2 of each, then d^4q/dt^4 of each."""
        each = [signals.deviating(k, x[k]) for x in self._fastest(signals) for k in range(self._rows.n_dof)]
        return torch.stack(each)

    def _fastest(self, signals: Signals) -> Iterator[Tensor]:
        """Yield d^2q/dt^2 and d^4q/dt^4 (n, N) of the joints' fast motion, with the band's edge as unit [rad or m]."""
        t, edge_hz = signals.sequence(), 1.0 / (_EDGE_ROWS * self._rows.dt_out)
        x = signals.q - flat_below(signals.q, float(t[1] - t[0]), _FAST * edge_hz)
        for _ in range(_TERMS):
            x = signals.rate(signals.rate(x)) / (2.0 * math.pi * edge_hz) ** 2
            yield x

    def columns(self, joint: int, learnt: Learnt, along: Along | None) -> tuple[np.ndarray, np.ndarray]:
        if along is None:
            return nothing(len(self._rows.t))
        fastest = along["fastest"][:, joint]
        felt = np.flatnonzero(fastest.any(axis=1))
        return fastest[felt] * self._std[felt, None], self.at(joint)[felt]
