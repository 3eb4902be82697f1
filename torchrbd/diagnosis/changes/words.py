"""Sentences for a person about what changed between two diagnoses."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from torchrbd.diagnosis.changes.inertia import Load
from torchrbd.diagnosis.changes.results import Change, Difference
from torchrbd.diagnosis.numbers import MINUS, joined, measure, number, with_unit
from torchrbd.diagnosis.results import Finding, Quantity, Unexplained
from torchrbd.diagnosis.words import named, place, when

_MOST_NAMED = 5
_LEAST_CERTAIN, _MOST_CERTAIN = 0.01, 0.99


def certainty(probability: float) -> str:
    """Return a probability in two digits; none is ever quite certain."""
    if math.isnan(probability):
        return "–"
    if probability > _MOST_CERTAIN:
        return f"> {_MOST_CERTAIN:g}"
    return f"< {_LEAST_CERTAIN:g}" if probability < _LEAST_CERTAIN else f"{probability:.2f}"


def signed(d: Difference) -> str:
    """Return a difference with its 95 % interval, "+0.70 ± 0.10"."""
    words = measure(d.difference, 1.96 * d.std)
    bare = words.removeprefix("(")
    return words if bare.startswith((MINUS, "–")) else words.removesuffix(bare) + f"+{bare}"


def subject(finding: Finding) -> str:
    """Return "Coulomb friction of joint2", with the time where it acts for a time only."""
    inside = when(finding.where)
    where = f" of {place(finding)}" if finding.joints or finding.links else " of the whole robot"
    words = named(finding)
    return words[0].upper() + words[1:] + where + (f" ({inside})" if inside else "")


def of_both(finding: Finding, verdict: str, probability: float, parameters: Mapping[str, Difference]) -> str:
    """Say how an effect that both have differs."""
    told = {name: d for name, d in parameters.items() if not math.isnan(d.probability)}
    if not told:
        return f"{subject(finding)} is in both; how sure its parameters are is not known."
    if verdict == "changed":
        most = {name: d for name, d in told.items() if d.probability > 0.5}
        words = joined(f"{_name(name, finding)}{_moved(d)}" for name, d in most.items())
        return f"{subject(finding)} {words}; certainty {certainty(probability)}."
    words = joined(_pair(name, d, finding) for name, d in told.items())
    if verdict == "unchanged":
        return f"{subject(finding)} is as it was: {words}."
    return (
        f"{subject(finding)}: {words}; these data cannot tell whether it changed "
        f"(probability {certainty(probability)})."
    )


def of_one(finding: Finding, verdict: str, side: str, parameters: Mapping[str, Difference], other: str) -> str:
    """Say what the other data say of an effect that one alone has; ``other`` is why they say nothing, or empty."""
    news = "is new" if side == "after" else "is gone"
    if other:
        return f"{subject(finding)} was found only {side}; {other}."
    ((name, d),) = parameters.items()
    unit = (d.before or d.after or Quantity(0.0, 0.0, "")).unit
    missing, found = (d.before, d.after) if side == "after" else (d.after, d.before)
    assert missing is not None
    assert found is not None
    label = name.replace("_", " ")
    there = with_unit(measure(missing.value, 1.96 * missing.std), unit)
    here = with_unit(measure(found.value, 1.96 * found.std), unit)
    order = f"was {there}, is {here}" if side == "after" else f"was {here}, is {there}"
    if verdict == "changed":
        return f"{subject(finding)} {news}: {label} {order}; certainty {certainty(d.probability)}."
    if verdict == "unchanged":
        return f"{subject(finding)} was found only {side}, but the other data allow as much: {label} {order}."
    return (
        f"{subject(finding)} was found only {side}; the other data could not have told: {label} {order} "
        f"(probability of a change {certainty(d.probability)})."
    )


def renamed(finding: Finding, others: Sequence[Finding], side: str) -> str:
    """Say that what one calls so, the other may call otherwise."""
    instead = joined(named(f) for f in others)
    return (
        f"{subject(finding)} was found only {side}; the other diagnosis has {instead} instead, which may be another "
        "name for the same: no change is certain."
    )


def of_unexplained(one: Unexplained, found: str) -> str:
    """Say where something without a name is, and in which diagnosis."""
    where = joined(one.joints)
    on = f" that depends on {joined(one.depends_on)}" if one.depends_on else ""
    if found == "both":
        return f"Something without a name at {where}{on} is in both; whether it changed is not told."
    return f"Something without a name at {where}{on} was found only {found}; that it was not found is no proof."


def of_inertia(verdict: str, probability: float, parameters: Mapping[str, Difference], load: Load | None) -> str:
    """Say what changed in the rigid body."""
    changed = [name for name, d in parameters.items() if d.probability > 0.5]
    if verdict == "unchanged":
        return f"Inertial parameters are as they were, in all {len(parameters)} combinations that both data sets tell."
    if verdict == "open":
        most = max(parameters, key=lambda name: parameters[name].probability)
        return (
            f"Inertial parameters: these data cannot tell whether they changed; most likely {most} did, by "
            f"{with_unit(signed(parameters[most]), _unit(parameters[most]))} "
            f"(probability {certainty(probability)})."
        )
    words = f"Inertial parameters changed, in {len(changed)} of {len(parameters)} combinations that both data sets tell"
    if load is not None:
        words += f", {as_if(load)}"
    return f"{words}; certainty {certainty(probability)}."


def as_if(load: Load) -> str:
    """Return "as if link2 or link3 had 0.50 ± 0.04 kg less"."""
    mass = with_unit(measure(abs(load.mass), 1.96 * load.std), "kg")
    return f"as if {joined(load.links, 'or')} had {mass} {'more' if load.mass > 0 else 'less'}"


def overall(changes: Sequence[Change]) -> str:
    """Say in one sentence or two what changed."""
    changed = [c for c in changes if c.verdict == "changed"]
    open_ones = sum(c.verdict == "open" for c in changes)
    same = sum(c.verdict == "unchanged" for c in changes)
    if not changes:
        return "Neither diagnosis has anything to compare."
    head = "No change is certain." if not changed else " ".join(c.statement for c in changed[:_MOST_NAMED])
    if len(changed) > _MOST_NAMED:
        head += f" {len(changed) - _MOST_NAMED} more changes are certain."
    tail = [f"{same} of {len(changes)} are as they were"] if same else []
    tail += [f"of {open_ones} the data cannot tell"] if open_ones else []
    return " ".join(filter(None, (head, f"{joined(tail)}.".capitalize() if tail else "")))


def _name(parameter: str, finding: Finding) -> str:
    """Return "static " where the effect's name does not say which parameter is meant."""
    words = parameter.replace("_", " ")
    return "" if len(finding.parameters) == 1 or words in named(finding).lower() else f"{words} "


def _moved(d: Difference) -> str:
    assert d.before is not None
    assert d.after is not None
    if d.before.value * d.after.value < 0:
        verb = "went"
    else:
        verb = "grew" if abs(d.after.value) > abs(d.before.value) else "fell"
    after = with_unit(number(d.after.value), _unit(d))
    return f"{verb} from {number(d.before.value)} to {after} ({signed(d)})"


def _pair(name: str, d: Difference, finding: Finding) -> str:
    assert d.before is not None
    assert d.after is not None
    values = with_unit(f"{number(d.before.value)} and {number(d.after.value)}", _unit(d))
    return f"{_name(name, finding)}{values} ({signed(d)})"


def _unit(d: Difference) -> str:
    return (d.after or d.before or Quantity(0.0, 0.0, "")).unit
