"""How far the parameters of a finding are from the true ones, and whether their intervals hold these."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

# Parameters that say where on a joint, or where in a period: told to a radian, not to their distance from a zero that
# means nothing.
POSITIONS = frozenset({"rest_position", "centre", "start", "end", "contact_position", "dead_centre", "phase"})
# Parameters that the torque is not proportional to.
SHAPES = POSITIONS | {
    "stribeck_speed", "exponent", "time_constant", "width", "distance", "order", "limit", "crank_ratio"
}  # fmt: skip
# Numbers that are choices of the model, not found.
CHOICES = frozenset({"side", "step"})
# Values at which the effect vanishes, where that is not zero.
NEUTRAL = {"gain": 1.0}
NORMAL_95 = 1.96


def parameter_errors(wanted: Mapping[str, float], found: Mapping[str, Any]) -> dict[str, tuple[Any, ...]]:
    """Return the errors of the parameters that truth and finding share.

    A coefficient's is relative to the largest one of its unit (a force along z makes no error of its zero along x
    infinite), a shape's to its own value, a position's to at least a radian.

    Args:
        wanted: true values by name.
        found: of diagnosis.json, by name: value, std, unit.

    Returns:
        "errors", "shape_errors", and "covered": whether each interval of 95 % holds the truth.
    """
    told = {k: q for k, q in found.items() if k in wanted and k not in CHOICES and q["value"] is not None}
    strength = {k: abs(wanted[k] - NEUTRAL.get(k, 0.0)) for k in told}
    errors: dict[bool, list[float]] = {False: [], True: []}
    covered = []
    for name, q in told.items():
        miss = abs(q["value"] - wanted[name])
        if name == "phase":
            miss = abs((miss + math.pi) % (2 * math.pi) - math.pi)
        shape = name in SHAPES
        alike = [name] if shape else [k for k, other in told.items() if other["unit"] == q["unit"] and k not in SHAPES]
        scale = max(max(strength[k] for k in alike), float(name in POSITIONS))
        errors[shape].append(miss / scale if scale > 0 else math.inf)
        if q.get("std"):
            covered.append(miss <= NORMAL_95 * q["std"])
    return {"errors": tuple(errors[False]), "shape_errors": tuple(errors[True]), "covered": tuple(covered)}
