"""What effects, places and times are called."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence

from torchrbd.diagnosis.decisions import DECISIONS
from torchrbd.diagnosis.results import Alternative, Finding, NextEffect, Quantity, Where
from torchrbd.effects import effect, known_effects
from torchrbd.report.text.numbers import joined, measure, number, plain, with_unit

# What one sentence can hold; a card or table has the rest.
_MOST_VALUES, _FEW_VALUES = 6, 4
# With these many joints "all but one", "all but two" is shorter than a list.
_FOR_ALL, _FOR_ALL_BUT_ONE, _FOR_ALL_BUT_TWO = 2, 4, 6
WHOLE_ROBOT = "whole robot"
_SIGNALS = {"q": "position", "qd": "velocity", "qdd": "acceleration"}
_PARAMETERS = {
    "coulomb": "Coulomb friction",
    "coulomb_plus": "Coulomb friction forwards",
    "coulomb_minus": "Coulomb friction backwards",
    "static": "static friction",
    "stribeck_speed": "Stribeck speed",
    "viscous": "viscous coefficient",
}

# Words for things of which there are one or two; friction, drag, backlash have no article.
_COUNTED = frozenset(
    ("offset", "spring", "coupling", "base", "payload", "force", "counterbalance", "loss", "error", "delay")
)


def words_of(identifier: str) -> str:
    """Return an effect's name in words, whether or not it is registered here."""
    return effect(identifier).words if identifier in known_effects() else identifier.replace("_", " ")


def parameter_words(name: str) -> str:
    """Return what a parameter of an effect is called: "rest position"."""
    return _PARAMETERS.get(name, name.replace("_", " "))


def signal_words(signal: str) -> str:
    """Return a signal in words, with the joint that it belongs to: "the velocity of joint2", or its name."""
    kind, _, joint = signal.partition("_")
    return f"the {_SIGNALS[kind]} of {joint}" if joint and kind in _SIGNALS else signal


def with_article(words: str) -> str:
    """Return "a joint spring", but "Coulomb friction"."""
    counted = not _COUNTED.isdisjoint(words.split())
    vowel = words[0] in "aeiou" and not words.startswith("one")
    return f"{'an' if vowel else 'a'} {words}" if counted else words


def named(item: Finding | Alternative | NextEffect) -> str:
    """Return an effect by name, with the joint that it depends on: "coupling to joint1's position"."""
    words, others = words_of(item.effect), joined(s.partition("_")[2] for s in item.depends_on)
    if not others:
        return words
    if "another joint's" in words:
        return words.replace("another joint's", f"{others}'s")
    if "two joints" in words:
        return words.replace("two joints", f"this joint and {others}")
    return f"{words} that depends on {joined(map(signal_words, item.depends_on))}"


def placed(item: Finding | Alternative | NextEffect, everywhere: Sequence[str] = ()) -> str:
    """Return an effect by name and place: "payload on link5", "time delay of the torque on the whole robot"."""
    return named(item) + (at(item.joints, item.links, everywhere) or " on the whole robot")


def guessed(finding: Finding) -> str:
    """Return what a finding is called; one that is no likelier than not behind its first rival.

    E.g. "torque ripple", "backlash at joint3 or possibly torque ripple", "possibly torque ripple".
    """
    if finding.probability > DECISIONS.likely:
        return named(finding)
    rival = next(iter(alternatives(finding)), "")
    return f"{rival} or possibly {named(finding)}" if rival else f"possibly {named(finding)}"


def alternatives(finding: Finding) -> list[str]:
    """Return the effects that this data cannot distinguish from a finding, with their place where it is another one."""
    here = finding.joints, finding.links
    return list(
        dict.fromkeys(named(a) if (a.joints, a.links) == here else placed(a) for a in finding.indistinguishable_from)
    )


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
    return joined((*item.joints, *item.links)) or WHOLE_ROBOT


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
    return words + (f" (URDF: {number(q.urdf)})" if q.urdf else "")


def values(finding: Finding) -> list[str]:
    """Return the quantities of a finding by name, "mass 1.2 ± 0.1 kg"; of many, the first few.

    Of a single one that the effect's name says, the value alone.
    """
    own = known_effects().get(finding.effect)
    kinds = {} if own is None else own.kinds

    def words(name: str, q: Quantity) -> str:
        return kinds.get(name, {}).get(q.value, f"{parameter_words(name)} {value(q)}")

    alone = len(properties(finding)) == 1
    named_by_effect = words_of(finding.effect).lower()
    found = [
        value(q) if alone and name.replace("_", " ") in named_by_effect else words(name, q)
        for name, q in known(finding).items()
    ]
    return found if len(found) <= _MOST_VALUES else found[:_FEW_VALUES]


def properties(finding: Finding) -> dict[str, Quantity]:
    """Return the quantities of a finding but those that follow from others or are of the data, and a kind of zero."""
    own = known_effects().get(finding.effect)
    aside, kinds = ((), ()) if own is None else ((*own.follows, *own.of_the_data), own.kinds)
    found = {name: q for name, q in finding.parameters.items() if name not in aside}
    return {name: q for name, q in found.items() if name not in kinds or q.value != 0.0}


def known(finding: Finding) -> dict[str, Quantity]:
    """Return those that have a value."""
    return {name: q for name, q in properties(finding).items() if q.at_least is not None or not math.isnan(q.value)}


def more_values(finding: Finding) -> int:
    """Return how many quantities of a finding ``values`` leaves out."""
    return len(properties(finding)) - len(values(finding))


def most_changed(finding: Finding) -> str | None:
    """Return the joint that shows a finding: its own, or if that does not, the one whose error falls most."""
    pairs = {j: (b, finding.nmse_after[j]) for j, b in finding.nmse_before.items() if j in finding.nmse_after}
    gains = {j: before - after for j, (before, after) in pairs.items() if math.isfinite(before - after)}
    own = [j for j in finding.joints if j in gains]
    shown = [j for j in own if gains[j] > DECISIONS.no_change * pairs[j][0]]
    if not shown and own and finding.share < DECISIONS.no_change:
        return own[0]
    return shown[0] if shown else max(gains, key=lambda j: gains[j], default=None)
