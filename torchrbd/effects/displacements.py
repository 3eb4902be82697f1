"""Joints, bases and encoders that are off by more than the slope of a torque tells.

The torque of a displacement e along a straight line is, to second order, its slope halfway:

    tau(e) - tau(0) = e . dtau/de at e/2 + O(e^3)

Where that is depends on e itself, so that it is a shape parameter that follows from the coefficients.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from torchrbd.effects.base import Effect, Shape

# A displacement [rad, m] of which the first order leaves about a hundredth.
_SMALL = 0.02


def about(effect: Effect, displacement: Sequence[float]) -> Shape:
    """Return for which displacement (K,) [rad, m] an effect is to be told: none, where slopes are, for a small one.

    What no torque feels is not a number, and none as well.
    """
    felt = [0.0 if math.isnan(e) else e for e in displacement]
    small = max(map(abs, felt)) <= _SMALL
    return dict.fromkeys(effect.follows, 0.0) if small else dict(zip(effect.follows, felt, strict=True))
