"""Which side of the gear a joint's friction acts on: the motor, or the link behind the gear."""

from __future__ import annotations

from collections.abc import Mapping

from torchrbd.effects.base import Shape

PARTS: Mapping[float, str] = {0.0: "friction of the motor", 1.0: "friction of the link"}
"""Share of the joint's friction that acts on the link, with words for each value."""


def link_part(shape: Shape) -> float:
    """Return the share of the joint's friction that acts on the link; 0 if the shape does not give it."""
    return min(max(shape.get("link_friction", 0.0), 0.0), 1.0)
