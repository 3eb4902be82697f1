"""Errors of joint origins, bases and encoders that are too large for a first-order term.

The torque of a displacement e along a straight line is, to second order, its derivative at half the way:

    tau(e) - tau(0) = e . dtau/de at e/2 + O(e^3)

That point depends on e itself: it is a shape parameter that is computed from the coefficients.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from torchrbd.effects.base import Effect, Shape

# Displacement [rad, m] up to which the first-order term is accurate to about one percent.
_SMALL = 0.02


def about(effect: Effect, displacement: Sequence[float]) -> Shape:
    """Return the displacement (K,) [rad, m] at which derivatives are taken, as a shape: zero for a small displacement.

    A component that changes no torque is NaN in the argument and zero in the result.
    """
    felt = [0.0 if math.isnan(e) else e for e in displacement]
    small = max(map(abs, felt)) <= _SMALL
    return dict.fromkeys(effect.follows, 0.0) if small else dict(zip(effect.follows, felt, strict=True))
