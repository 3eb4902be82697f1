"""Friction that holds a joint at a reversal: sum_i f_i c (g'_i - g).

Friction has sharp edges, with one exception. At a reversal a joint rests while its friction changes from one side to
the other; the smoothed positions do not show this. The drive pushes harder until the joint breaks away, so friction
follows a straight line: g' is g with straight lines across rests, for shorter and longer rests. Their share f depends
on the drive: a joint that passes through zero speed does not rest.
"""

from __future__ import annotations

import numpy as np

from torchrbd.nuisance.component import Along, Learnt, OfEachJoint
from torchrbd.nuisance.directions import STICKS, Directions


class Sticking(OfEachJoint):
    """Straight lines of friction across rests, for each of ``STICKS``.

    Args:
        directions: of the motion.
    """

    def __init__(self, directions: Directions) -> None:
        super().__init__(len(directions.moving), len(STICKS))
        self._directions = directions

    def columns(self, joint: int, learnt: Learnt, along: Along | None) -> tuple[np.ndarray, np.ndarray]:
        held = self._directions.held(joint, float(learnt.rest_width[joint]))
        return float(learnt.friction[joint, 1]) * held, self.at(joint)
