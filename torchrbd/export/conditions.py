"""What a model knows of single recordings and no file for a simulator holds, in sentences."""

from __future__ import annotations

from collections.abc import Iterator

from torchrbd.export.xml_text import element_text
from torchrbd.model import OTHERS, Condition, RigidBodyDynamics
from torchrbd.parameters import PARAMETERS_PER_BODY


def conditions_not_exported(model: RigidBodyDynamics) -> tuple[str, ...]:
    """Return how recordings were made that the model was fitted to or judged on, one sentence for those made alike."""
    names: dict[str, list[str]] = {}
    for name, condition in model.conditions.items():
        for words in _sentences(condition):
            names.setdefault(words, []).append("all others" if name == OTHERS else name)
    return tuple(f"recordings {', '.join(own)}: {words}; not in this file" for words, own in names.items())


def _sentences(condition: Condition) -> Iterator[str]:
    if condition.delay_s:
        way = "late" if condition.delay_s > 0 else "early"
        yield f"the torque is {abs(condition.delay_s):.4g} s {way}"
    if condition.lag_s:
        by_hand = element_text("general", {"dyntype": "filterexact", "dynprm": (condition.lag_s,)})
        yield f"the torque is a command that actuators follow with a lag of {condition.lag_s:.4g} s ({by_hand})"
    if condition.load is not None:
        yield f"the robot carries a known load of {float(condition.load[::PARAMETERS_PER_BODY].sum()):.4g} kg"
    if condition.simulated:
        yield f"the torque includes what the simulation {condition.simulated} has beyond the URDF"
