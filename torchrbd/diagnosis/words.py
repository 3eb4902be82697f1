"""Sentences for a person: what was found and where, findings, verdicts."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence

from torchrbd.diagnosis.numbers import joined, measure, number, percent, plain, with_unit
from torchrbd.diagnosis.results import Alternative, Finding, Quantity, Unexplained, Where
from torchrbd.inference.results import Fit
from torchrbd.physics import effect, effects

# Normal on every robot: named after what is special.
PLAIN = ("viscous_friction", "coulomb_friction", "torque_offset")
# Findings less probable than this stay out of the verdict's sentence.
LIKELY = 0.5
_WRONG = "wrong "
# Said together where they are found at the same joints.
_JOINED = ("viscous friction", "Coulomb friction")
# Words for things of which there are one or two; friction, drag, backlash have no article.
_COUNTED = frozenset(
    ("offset", "spring", "coupling", "base", "payload", "force", "counterbalance", "loss", "error", "delay")
)
# What one sentence can hold; a card or table has the rest.
_MOST_NAMED, _MOST_VALUES, _MOST_ALIKE = 5, 6, 4
_FEW_VALUES = 4
# With these many joints "all but one", "all but two" is shorter than a list.
_FOR_ALL, _FOR_ALL_BUT_ONE, _FOR_ALL_BUT_TWO = 2, 4, 6
# A relative change of nmse that held-out time does not tell from none.
_NO_CHANGE = 0.02


def words_of(identifier: str) -> str:
    """Return an effect's name in words, whether or not it is registered here."""
    return effect(identifier).words if identifier in effects() else identifier.replace("_", " ")


def named(item: Finding | Alternative) -> str:
    """Return an effect by name, with the joint that it depends on: "coupling to joint1's position"."""
    words, others = words_of(item.effect), joined(s.partition("_")[2] for s in item.depends_on)
    if not others:
        return words
    if "another joint's" in words:
        return words.replace("another joint's", f"{others}'s")
    return f"{words} that depends on {joined(item.depends_on)}"


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
    words = with_unit(measure(q.value, 1.96 * q.std), q.unit)
    return words + (f" (the URDF says {number(q.urdf)})" if q.urdf else "")


def values(finding: Finding) -> list[str]:
    """Return the quantities of a finding by name, "mass 1.2 ± 0.1 kg"; of many, the first few."""
    known = {name: q for name, q in finding.parameters.items() if not math.isnan(q.value)}
    found = [f"{name.replace('_', ' ')} {value(q)}" for name, q in known.items()]
    return found if len(found) <= _MOST_VALUES else found[:_FEW_VALUES]


def finding_sentence(finding: Finding, *, more: bool = False) -> str:
    """Say what was found, how large it is, what it is worth on held-out time, and what else it could be.

    Args:
        finding: what was found.
        more: whether it comes on top of the same effect in all recordings.
    """
    quantities, where = finding.parameters.items(), finding.where
    if any(q.value in (r.low, r.high) for _, q in quantities for r in where.region or ()):
        where = Where(where.recordings, where.time_s)
    inside = when(where)
    told, words = values(finding), words_of(finding.effect).lower()
    if len(quantities) == 1:
        told = [value(q) if name.replace("_", " ") in words else told[0] for name, q in quantities]
    certain = " (± 95 %)" if any(q.std > 0 for _, q in quantities) else ""
    subject = place(finding) if finding.joints or finding.links else "Whole robot"
    sentence = f"{subject}: {named(finding)}{f' ({inside})' if inside else ''}"
    sentence += f", {', '.join(told)}{certain}" if told else ""
    sentence += ", on top of that of all recordings." if more else "."
    return " ".join(filter(None, (sentence, _worth(finding), _alike(finding))))


def most_changed(finding: Finding) -> str | None:
    """Return the joint that shows a finding: its own, or the one whose held-out error falls most."""
    gains = {j: b - finding.nmse_after[j] for j, b in finding.nmse_before.items() if j in finding.nmse_after}
    gains = {j: gain for j, gain in gains.items() if math.isfinite(gain)}
    own = [j for j in finding.joints if j in gains]
    return own[0] if own else max(gains, key=lambda j: gains[j], default=None)


def _worth(finding: Finding) -> str:
    joint = most_changed(finding)
    if joint is None:
        return ""
    before, after = finding.nmse_before[joint], finding.nmse_after[joint]
    variance = "the torque variance" + ("" if joint in finding.joints else f" of {joint}")
    if abs(before - after) <= _NO_CHANGE * max(before, after):
        return f"Held-out time does not show it: {percent(after)} of {variance} stays unpredicted with and without it."
    return f"Without it {percent(before)} of {variance} on held-out time stays unpredicted, with it {percent(after)}."


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


def verdict_statement(
    verdict: str,
    findings: Sequence[Finding],
    rest: Sequence[Unexplained],
    fits: Mapping[str, Fit],
    model: str = "URDF",
) -> str:
    """Say the verdict in one or two sentences; ``model`` is what the recordings are compared with."""
    urdf, rigid, extended = (percent(fits[name].mean_nmse) for name in ("urdf", "rigid_body", "extended"))
    everywhere = [j for j, nmse in fits["urdf"].nmse.items() if math.isfinite(nmse)]
    open_end = ""
    if rest:
        open_end = f" Something is left unexplained{at([j for u in rest for j in u.joints], (), everywhere)}."
    if verdict == "consistent":
        return f"The {model} as given explains the recordings: nothing is missing that this data could show."
    if verdict == "parameters":
        return (
            f"A rigid body explains the recordings, but not with the {model}'s inertial parameters. "
            f"Re-fitted ones lower the unpredicted part of the torque variance on held-out time from {urdf} to {rigid}."
        )
    if verdict == "unexplained":
        return f"No known effect explains what the rigid body leaves.{open_end}"
    likely = [f for f in findings if f.probability > LIKELY] or findings
    special = _told([f for f in likely if f.effect not in PLAIN], everywhere)
    plain_ones = sorted((f for f in likely if f.effect in PLAIN), key=lambda f: PLAIN.index(f.effect))
    usual = _told(plain_ones, everywhere)
    first, second = (special, f" It also {usual}." if usual else "") if special else (usual, "")
    return (
        f"The {model} {first}.{second} The unpredicted part of the torque variance on held-out time is {urdf} with the "
        f"{model}, {rigid} with a re-fitted rigid body and {extended} with what was found.{open_end}"
    )


def _told(findings: Sequence[Finding], everywhere: Sequence[str]) -> str:
    """Return "leaves out ..." and "has the wrong ...", or nothing."""
    wrong = [f for f in findings if _is_wrong(f)]
    parts = {"leaves out": [f for f in findings if f not in wrong], "has the wrong": wrong}
    return " and ".join(f"{verb} {_places(those, everywhere)}" for verb, those in parts.items() if those)


def _is_wrong(finding: Finding) -> bool:
    return words_of(finding.effect).startswith(_WRONG) or any(q.urdf for q in finding.parameters.values())


def _places(findings: Sequence[Finding], everywhere: Sequence[str]) -> str:
    """Return e.g. "joint spring at joint3 and payload on link5" or "viscous and Coulomb friction at all joints"."""
    sites: dict[tuple[str, str, tuple[str, ...]], list[str]] = {}
    for f in findings:
        inside = when(Where(f.where.recordings, f.where.time_s))
        words = named(f).removeprefix(_WRONG) if _is_wrong(f) else _with_article(named(f))
        sites.setdefault((words, f" ({inside})" if inside else "", f.links), []).extend(f.joints)
    places: dict[tuple[str, str], list[str]] = {}
    for (words, inside, links), joints in sites.items():
        alone = "" if words in _JOINED else words
        places.setdefault((at(joints, links, everywhere) + inside, alone), []).append(words)
    told = [_shortened(words) + where for (where, _), words in places.items()]
    if len(told) > _MOST_NAMED + 1:
        told = [*told[:_MOST_NAMED], f"{len(told) - _MOST_NAMED} more"]
    return joined(told)


def _with_article(words: str) -> str:
    """Return "a joint spring", but "Coulomb friction"."""
    counted = not _COUNTED.isdisjoint(words.split())
    return f"{'an' if words[0] in 'aeiou' else 'a'} {words}" if counted else words


def _shortened(words: Sequence[str]) -> str:
    """Return "viscous and Coulomb friction" for "viscous friction" and "Coulomb friction"."""
    return words[0] if len(words) == 1 else joined(w.removesuffix(" friction") for w in words) + " friction"
