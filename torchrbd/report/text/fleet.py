"""Who differs in a fleet, and what changed."""

from __future__ import annotations

from torchrbd.comparison.results import Difference
from torchrbd.fleet.results import UNFINISHED, Deviation, FleetComparison, MemberResult
from torchrbd.fleet.sisters import LEAST_SISTERS
from torchrbd.report.text.comparison import as_if
from torchrbd.report.text.numbers import number, with_unit

_MOST_NAMED = 3
_NOT_COMPARED = {
    "": "",
    "unknown": "no earlier results of it exist",
    "unreadable": "{detail}",
    "other robot": "it was robot '{detail}' then",
    "other bodies": "inertial parameters are not compared, as bodies or kinematics differ",
    "none identified": "no combination of inertial parameters is identified by both data sets",
    "other bodies, no term": "bodies or kinematics differ, and the two have no term in common",
    "none identified, no term": "the two data sets identify no parameter in common",
}


def member_statement(one: MemberResult) -> str:
    """Say of one robot how it differs from its sisters, and what changed since the earlier time."""
    if one.verdict == UNFINISHED:
        return "is not identified yet, as the run was ended early"
    if one.error:
        return one.error
    return "; ".join(filter(None, (_sisters(one), _changes(one))))


def fleet_statement(result: FleetComparison) -> str:
    """Say what there is to look at."""
    members = result.members
    left = [one.name for one in members if one.verdict == UNFINISHED]
    failed = [one.name for one in members if one.error and one.verdict != UNFINISHED]
    off = [one.name for one in members if one.deviations]
    changed = [one.name for one in members if one.changes]
    differ = "differs from its sisters" if len(off) == 1 else "differ from their sisters"
    parts = [f"{len(off)} of {len(members)} robots {differ}" if off else "no robot differs from its sisters"]
    if any(one.changes is not None for one in members):
        parts.append(f"{len(changed)} changed" if changed else "none changed")
    if failed:
        parts.append(f"{len(failed)} could not be identified")
    text = ", ".join(parts)
    text = f"{text[0].upper()}{text[1:]}."
    if left:
        were = "robot is" if len(left) == 1 else "robots are"
        text += f" Unfinished: {len(left)} of {len(members)} {were} not identified yet; the same call goes on."
    return text


def parameter_name(parameter: str) -> str:
    """Return a parameter as a person reads it: "viscous friction joint1"; a combination of inertial ones as it is."""
    term, dot, own = parameter.rpartition(".")
    if not dot or not own.isidentifier():
        return parameter
    more = f", {own}" if own not in term else ""
    return f"{term}{more}".replace("_", " ")


def _sisters(one: MemberResult) -> str:
    others = one.sisters - 1
    if one.sisters < LEAST_SISTERS:
        return f"has {others or 'no'} sister{'' if others == 1 else 's'}, too few to compare with"
    if not one.deviations:
        return f"is like its {others} sisters"
    words = f"differs: {_listed([_deviation(d) for d in one.deviations])}"
    return words if one.load is None else f"{words}; {as_if(one.load)}"


def _changes(one: MemberResult) -> str:
    why = _NOT_COMPARED[one.not_compared].format(detail=one.not_compared_detail)
    if one.changes is None:
        return f"not compared with the earlier time: {why}" if why else ""
    if one.changes:
        words = f"changed: {_listed([_change(*item) for item in one.changes.items()])}"
    else:
        words = "nothing that was compared has changed" if why else "nothing has changed"
    return f"{words}; {why}" if why else words


def _deviation(d: Deviation) -> str:
    value = with_unit(number(d.value.value), d.value.unit)
    return f"{parameter_name(d.parameter)} {value} (median {number(d.median)})"


def _change(parameter: str, d: Difference) -> str:
    assert d.before is not None
    assert d.after is not None
    after = with_unit(number(d.after.value), d.after.unit)
    return f"{parameter_name(parameter)} {number(d.before.value)} → {after}"


def _listed(items: list[str]) -> str:
    more = [f"{len(items) - _MOST_NAMED} more"] if len(items) > _MOST_NAMED else []
    return ", ".join([*items[:_MOST_NAMED], *more])
