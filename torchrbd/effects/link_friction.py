"""Whose the friction at a joint is: the motor's, or that of the link behind the gear."""

from __future__ import annotations

from collections.abc import Mapping

from torchrbd.effects.base import Shape

PARTS: Mapping[float, str] = {0.0: "friction of the motor", 1.0: "friction of the link"}
"""Of the friction at a joint, what the link may have, and words for it."""


def link_part(shape: Shape) -> float:
    """Return the part of the friction at a joint that is the link's; none if the shape does not tell."""
    return min(max(shape.get("link_friction", 0.0), 0.0), 1.0)
