"""What a model knows of single recordings and no file for a simulator holds."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

from torchrbd.display import Remark
from torchrbd.export.xml_text import element_text
from torchrbd.model import OTHERS, Condition, RigidBodyDynamics
from torchrbd.parameters import PARAMETERS_PER_BODY


def conditions_not_exported(model: RigidBodyDynamics) -> tuple[Remark, ...]:
    """Return how recordings were made that the model was fitted to or judged on, one remark for those made alike."""
    names: dict[str, list[str]] = {}
    for name, condition in model.conditions.items():
        for values in _values(condition):
            names.setdefault(json.dumps(values), []).append("all others" if name == OTHERS else name)
    return tuple(
        Remark("condition of recordings", {"recordings": own, **json.loads(values)}) for values, own in names.items()
    )


def _values(condition: Condition) -> Iterator[dict[str, Any]]:
    """Yield what is special of a recording, one thing at a time, in four digits."""
    if condition.delay_s:
        yield {"delay_s": _rounded(condition.delay_s)}
    if condition.lag_s:
        by_hand = element_text("general", {"dyntype": "filterexact", "dynprm": (condition.lag_s,)})
        yield {"lag_s": _rounded(condition.lag_s), "by_hand": by_hand}
    if condition.load is not None:
        yield {"load": _rounded(float(condition.load[::PARAMETERS_PER_BODY].sum()))}
    if condition.simulated:
        yield {"simulation": condition.simulated}


def _rounded(x: float) -> float:
    return float(f"{x:.4g}")
