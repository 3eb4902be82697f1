"""MJCF attributes that several effects share."""

from __future__ import annotations

import math
from collections.abc import Sequence


def affine(torque: float) -> dict[str, float | tuple[float, ...] | str]:
    """Return the attributes of an actuator that adds a constant torque to its command."""
    return {"biastype": "affine", "biasprm": (torque, 0.0, 0.0)}


def quaternion(turn: Sequence[float]) -> tuple[float, ...]:
    """Return the unit quaternion (w, x, y, z) of a rotation vector [rad]."""
    angle = math.hypot(*turn)
    part = math.sin(0.5 * angle) / angle if angle else 0.5
    return (math.cos(0.5 * angle), *(part * v for v in turn))
