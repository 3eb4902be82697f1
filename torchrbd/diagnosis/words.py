"""Sentences for a person: what was found, where, how sure, and what else it could be."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import astuple

from torchrbd.diagnosis.numbers import as_large, joined, measure, number, percent, plain, with_unit
from torchrbd.diagnosis.posterior import LIKELY
from torchrbd.diagnosis.results import HELD_OUT, Alternative, Finding, Quantity, Where
from torchrbd.effects import effect, known_effects
from torchrbd.robot import RobotModel

# What one sentence can hold; a card or table has the rest.
_MOST_VALUES, _MOST_ALIKE = 6, 4
_FEW_VALUES = 4
# With these many joints "all but one", "all but two" is shorter than a list.
_FOR_ALL, _FOR_ALL_BUT_ONE, _FOR_ALL_BUT_TWO = 2, 4, 6
# A relative change of nmse that held-out time does not tell from none.
NO_CHANGE = 0.02


def torque_unit(robot: RobotModel, joint: int) -> str:
    """Return the unit of a joint's torque, or force."""
    return "N" if bool(robot.prismatic[joint]) else "N m"


def words_of(identifier: str) -> str:
    """Return an effect's name in words, whether or not it is registered here."""
    return effect(identifier).words if identifier in known_effects() else identifier.replace("_", " ")


def named(item: Finding | Alternative) -> str:
    """Return an effect by name, with the joint that it depends on: "coupling to joint1's position"."""
    words, others = words_of(item.effect), joined(s.partition("_")[2] for s in item.depends_on)
    if not others:
        return words
    if "another joint's" in words:
        return words.replace("another joint's", f"{others}'s")
    return f"{words} that depends on {joined(item.depends_on)}"


def strongest_first(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Return findings that are likelier than not, then the others, the largest gain first in both."""
    return tuple(sorted(findings, key=lambda f: (f.probability <= LIKELY, -f.log_evidence_gain)))


def guessed(finding: Finding) -> str:
    """Return what a finding is called; one that is no likelier than not behind its first rival.

    E.g. "torque ripple", "backlash at joint3 or perhaps torque ripple", "perhaps torque ripple".
    """
    if finding.probability > LIKELY:
        return named(finding)
    rival = next(iter(alternatives(finding)), "")
    return f"{rival} or perhaps {named(finding)}" if rival else f"perhaps {named(finding)}"


def all_or_some(joints: Iterable[str], everywhere: Sequence[str]) -> str:
    """Return joints in words and in the order of ``everywhere``: "all joints", "all joints but joint3", or a list."""
    found = dict.fromkeys(joints)
    rest = [j for j in everywhere if j not in found]
    for count, least in enumerate((_FOR_ALL, _FOR_ALL_BUT_ONE, _FOR_ALL_BUT_TWO)):
        if len(rest) == count and len(everywhere) >= least and all(j in everywhere for j in found):
            return "all joints" + (f" but {joined(rest)}" if rest else "")
    return joined(sorted(found, key=lambda j: everywhere.index(j) if j in everywhere else len(everywhere)))


def at(joints: Sequence[str], links: Sequence[str], everywhere: Sequence[str] = ()) -> str:
    """Return e.g. " at joint1 and joint2", " on link5"; nothing for the whole robot."""
    words = f" at {all_or_some(joints, everywhere)}" if joints else ""
    return words + (f" on {joined(links)}" if links else "")


def place(item: Finding) -> str:
    """Return the joints and links of a finding, or "whole robot"."""
    return joined((*item.joints, *item.links)) or "whole robot"


def when(where: Where, units: Mapping[str, str] | None = None) -> str:
    """Return in which recordings, when and in which region; nothing for everywhere.

    E.g. "only in load.csv", "in load.csv, 2.0 to 8.0 s".

    Args:
        where: the place.
        units: of signals, where they are known.
    """
    parts = [] if where.recordings is None else [f"{'' if where.time_s else 'only '}in {joined(where.recordings)}"]
    parts += [_span(low, high) for low, high in where.time_s or ()]
    parts += [
        with_unit(f"{r.signal} from {plain(r.low, 3)} to {plain(r.high, 3)}", (units or {}).get(r.signal, ""))
        for r in where.region or ()
    ]
    return ", ".join(parts)


def _span(low: float, high: float) -> str:
    if math.isinf(low):
        return f"until {high:.1f} s"
    return f"from {low:.1f} s on" if math.isinf(high) else f"{low:.1f} to {high:.1f} s"


def value(q: Quantity) -> str:
    """Return a quantity with its 95 % interval and unit, and what the URDF says of it: "1.635 ± 0.016 N m s/rad"."""
    if q.at_least is not None:
        return with_unit(f"above {number(q.at_least)}", q.unit)
    words = with_unit(measure(q.value, 1.96 * q.std), q.unit)
    return words + (f" (the URDF says {number(q.urdf)})" if q.urdf else "")


def values(finding: Finding) -> list[str]:
    """Return the quantities of a finding by name, "mass 1.2 ± 0.1 kg"; of many, the first few."""
    own = known_effects().get(finding.effect)
    kinds = {} if own is None else own.kinds

    def told(name: str, q: Quantity) -> str:
        return kinds.get(name, {}).get(q.value, f"{name.replace('_', ' ')} {value(q)}")

    found = [told(name, q) for name, q in _known(finding).items()]
    return found if len(found) <= _MOST_VALUES else found[:_FEW_VALUES]


def _properties(finding: Finding) -> dict[str, Quantity]:
    """Return the quantities of a finding but those that follow from others or are of the data, and a kind of zero."""
    own = known_effects().get(finding.effect)
    aside, kinds = ((), ()) if own is None else ((*own.follows, *own.of_the_data), own.kinds)
    told = {name: q for name, q in finding.parameters.items() if name not in aside}
    return {name: q for name, q in told.items() if name not in kinds or q.value != 0.0}


def _known(finding: Finding) -> dict[str, Quantity]:
    """Return those that have a value."""
    return {name: q for name, q in _properties(finding).items() if q.at_least is not None or not math.isnan(q.value)}


def more_values(finding: Finding) -> int:
    """Return how many quantities of a finding ``values`` leaves out."""
    return len(_properties(finding)) - len(values(finding))


def finding_sentence(finding: Finding, *, more: bool = False) -> str:
    """Say what was found, how large it is, what it is worth on held-out time, and what else it could be.

    Args:
        finding: what was found.
        more: whether it comes on top of the same effect in all recordings.
    """
    quantities, where = _properties(finding).items(), finding.where
    if any(q.value in (r.low, r.high) for _, q in quantities for r in where.region or ()):
        where = Where(where.recordings, where.time_s)
    inside = when(where)
    told, words = values(finding), words_of(finding.effect).lower()
    if len(quantities) == 1:
        told = [value(q) if name.replace("_", " ") in words else told[0] for name, q in quantities]
    certain = " (± 95 %)" if any(q.std > 0 for _, q in quantities) else ""
    subject = place(finding) if finding.joints or finding.links else "Whole robot"
    sentence = f"{subject}: {guessed(finding)}{f' ({inside})' if inside else ''}"
    sentence += f", {', '.join(told)}{certain}" if told else ""
    sentence += ", on top of that of all recordings." if more else "."
    return " ".join(filter(None, (sentence, _untold(finding), _worth(finding), _alike(finding))))


def most_changed(finding: Finding) -> str | None:
    """Return the joint that shows a finding: its own, or if that does not, the one whose error falls most."""
    pairs = {j: (b, finding.nmse_after[j]) for j, b in finding.nmse_before.items() if j in finding.nmse_after}
    gains = {j: before - after for j, (before, after) in pairs.items() if math.isfinite(before - after)}
    own = [j for j in finding.joints if j in gains]
    shown = [j for j in own if gains[j] > NO_CHANGE * pairs[j][0]]
    if not shown and own and finding.share < NO_CHANGE:
        return own[0]
    return shown[0] if shown else max(gains, key=lambda j: gains[j], default=None)


def _untold(finding: Finding) -> str:
    """Say that nothing that would be zero without it is told from zero; of several correlated numbers, all may be."""
    own, known = known_effects().get(finding.effect), _known(finding)
    whole = own is not None and finding.parameters.keys() >= own.units.keys()
    shape = own.coefficients({name: q.value for name, q in finding.parameters.items()})[1] if own and whole else {}
    sizes = {name: q for name, q in known.items() if name not in shape}
    alone = len(_properties(finding)) < 2 or len(sizes) == 1 < len(known)
    if alone or any(abs(q.value) >= 1.96 * q.std for q in sizes.values()):
        return ""
    if len(sizes) == len(known):
        return "No number of it is told from zero; together they are."
    names = joined(name.replace("_", " ") for name in sizes)
    return f"{names.capitalize()} are not told from zero one by one; together they are."


def _worth(finding: Finding) -> str:
    joint = most_changed(finding)
    unseen = "" if finding.judged_on == HELD_OUT else "Held-out time sees nothing of it"
    if joint is None:
        return unseen and f"{unseen}, and its own is too short to be divided."
    before, after = finding.nmse_before[joint], finding.nmse_after[joint]
    variance = "the torque variance" + ("" if joint in finding.joints else f" of {joint}")
    if unseen:
        return (
            f"{unseen}; of its own, each half predicted by a fit to the other, {percent(before)} of {variance} stays "
            f"unpredicted without it and {percent(after)} with it."
        )
    if abs(before - after) <= NO_CHANGE * max(before, after):
        return f"Held-out time does not show it: {percent(after)} of {variance} stays unpredicted with and without it."
    error = f"Without it {percent(before)} of {variance} on held-out time stays unpredicted, with it {percent(after)}"
    there = finding.confirmed
    return f"{error}." if there is None else f"{error}; held-out time has it {as_large(*astuple(there))}."


def _alike(finding: Finding) -> str:
    others = alternatives(finding)
    if not others:
        return ""
    more = len(others) - _MOST_ALIKE
    if more > 1:
        others = [*others[:_MOST_ALIKE], f"{more} other effects"]
    return f"This data cannot tell it from {joined(others, 'or')}."


def alternatives(finding: Finding) -> list[str]:
    """Return the effects that this data cannot tell from a finding, with their place where it is another one."""
    here = finding.joints, finding.links
    return list(
        dict.fromkeys(
            named(a) + ("" if (a.joints, a.links) == here else at(a.joints, a.links) or " on the whole robot")
            for a in finding.indistinguishable_from
        )
    )
