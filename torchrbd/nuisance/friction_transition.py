"""Width, delay and duration of friction's sign change: s dg/dlog w + l d(c g)/dt + r d^2(c g)/dt^2."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import numpy as np
from torch import Tensor

from torchrbd.dataset.rows import Rows
from torchrbd.effects import Signals
from torchrbd.nuisance.component import Along, Learnt, OfEachJoint
from torchrbd.nuisance.directions import Directions, turning

# Prior standard deviation of the relative width, and step of its central difference.
_WIDTH_STD, _WIDTH_STEP = 0.5, 1.1
# Prior standard deviation of the duration, in rows: about the resolution of the band.
_LASTING_ROWS = 0.5
_COEFFICIENTS = 3


class FrictionTransition(OfEachJoint):
    """How friction changes its sign.

    Args:
        rows: the data.
        directions: of the motion.
    """

    def __init__(self, rows: Rows, directions: Directions) -> None:
        super().__init__(rows.n_dof, _COEFFICIENTS)
        self._rows, self._directions = rows, directions

    def width(self, joint: int) -> int:
        """Return the index of the width."""
        return int(self.at(joint)[0])

    def along(self) -> Mapping[str, Callable[[Signals], Tensor]]:
        return {"turning": turning, "turning twice": lambda signals: signals.rate(turning(signals))}

    def columns(self, joint: int, learnt: Learnt, along: Along | None) -> tuple[np.ndarray, np.ndarray]:
        width, coulomb, sign = float(learnt.rest_width[joint]), float(learnt.friction[joint, 1]), self._directions.sign
        bend = sign(joint, width * _WIDTH_STEP).sum(0) - sign(joint, width / _WIDTH_STEP).sum(0)
        bend *= (not learnt.white) * _WIDTH_STD * coulomb / (2 * math.log(_WIDTH_STEP))
        if along is None:
            return bend[None], self.at(joint)[:1]
        late = coulomb * self._rows.dt * along["turning"][joint]
        lasting = coulomb * 0.5 * (_LASTING_ROWS * self._rows.dt_out) ** 2 * along["turning twice"][joint]
        return np.stack((bend, late, lasting)), self.at(joint)
