"""Sentences for a person about a fleet."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from torchrbd.diagnosis.changes.inertia import Load
from torchrbd.diagnosis.changes.results import Difference
from torchrbd.diagnosis.changes.words import as_if
from torchrbd.diagnosis.fleet.results import Deviation, MemberResult
from torchrbd.diagnosis.numbers import joined, number, with_unit

_MOST_NAMED = 3


def of_sisters(off: Sequence[Deviation], load: Load | None, sisters: int, least: int) -> str:
    """Say of one robot how it differs from its sisters."""
    if sisters < least:
        return f"has {sisters - 1 or 'no'} sisters, too few to compare with"
    if not off:
        return f"is like its {sisters - 1} sisters"
    said = f"differs: {joined(_deviation(d) for d in off[:_MOST_NAMED])}{_more(len(off))}"
    if load is not None:
        said += f"; {as_if(load)}"
    return said


def of_changes(changes: Mapping[str, Difference] | None, why: str) -> str:
    """Say what changed since the earlier time; ``why`` something was not compared, empty if all was."""
    if changes is None:
        return f"not compared with the earlier time: {why}"
    if changes:
        said = f"changed: {joined(map(_change, [*changes.items()][:_MOST_NAMED]))}{_more(len(changes))}"
    else:
        said = "nothing that was compared has changed" if why else "nothing has changed"
    return f"{said}; {why}" if why else said


def not_compared(inertial: Mapping[str, Difference] | None) -> str:
    """Say why no inertial parameters were compared: None for other ones, empty where the data tell none."""
    if inertial is None:
        return "inertial parameters are not compared, they were of other bodies or kinematics"
    return "no combination of inertial parameters is told by the data of both"


def of_fleet(members: Sequence[MemberResult]) -> str:
    """Say what there is to look at."""
    failed = [one.name for one in members if one.error]
    off = [one.name for one in members if one.deviations]
    changed = [one.name for one in members if one.changes]
    differ = "differs from its sisters" if len(off) == 1 else "differ from their sisters"
    parts = [f"{len(off)} of {len(members)} robots {differ}" if off else "no robot differs from its sisters"]
    if any(one.changes is not None for one in members):
        parts.append(f"{len(changed)} changed" if changed else "none changed")
    if failed:
        parts.append(f"{len(failed)} could not be identified")
    text = ", ".join(parts)
    return f"{text[0].upper()}{text[1:]}."


def name(parameter: str) -> str:
    """Return a parameter as a person reads it: "viscous friction joint1"; a combination of inertial ones as it is."""
    term, dot, own = parameter.rpartition(".")
    if not dot or not own.isidentifier():
        return parameter
    more = f", {own}" if own not in term else ""
    return f"{term}{more}".replace("_", " ")


def _deviation(d: Deviation) -> str:
    return (
        f"{name(d.parameter)} {with_unit(number(d.value.value), d.value.unit)} where the median is {number(d.median)}"
    )


def _change(item: tuple[str, Difference]) -> str:
    parameter, d = item
    assert d.before is not None
    assert d.after is not None
    return f"{name(parameter)} {number(d.before.value)} → {with_unit(number(d.after.value), d.after.unit)}"


def _more(count: int) -> str:
    return f" and {count - _MOST_NAMED} more" if count > _MOST_NAMED else ""
