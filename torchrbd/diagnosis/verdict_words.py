"""The sentences that a report begins with: the verdict, and what was found where, told once for many joints."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import astuple

from torchrbd.deadline import reason_words, stopped
from torchrbd.diagnosis.numbers import as_large, joined, percent
from torchrbd.diagnosis.posterior import LIKELY
from torchrbd.diagnosis.results import Finding, Ratio, Unexplained, Where
from torchrbd.diagnosis.words import alternatives, at, named, when, words_of
from torchrbd.effects.registry import PLAIN
from torchrbd.inference.suspicions.results import Suspicions
from torchrbd.inference.torque_error import Fit

_WRONG = "wrong "
# Said together where they are found at the same joints.
_JOINED = ("viscous friction", "Coulomb friction")
# Words for things of which there are one or two; friction, drag, backlash have no article.
_COUNTED = frozenset(
    ("offset", "spring", "coupling", "base", "payload", "force", "counterbalance", "loss", "error", "delay")
)
# What one sentence can hold; cards and tables have the rest.
_MOST_NAMED = 5


def verdict_statement(
    verdict: str,
    findings: Sequence[Finding],
    rest: Sequence[Unexplained],
    fits: Mapping[str, Fit],
    model: str = "URDF",
    confirmed: Ratio | None = None,
) -> str:
    """Say the verdict in a few sentences.

    Args:
        verdict, findings, rest, confirmed: of the diagnosis.
        fits: of its identification.
        model: what the recordings are compared with.
    """
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
    likely = [f for f in findings if f.probability > LIKELY]
    special = _told([f for f in likely if f.effect not in PLAIN], everywhere)
    plain_ones = sorted((f for f in likely if f.effect in PLAIN), key=lambda f: PLAIN.index(f.effect))
    usual = _told(plain_ones, everywhere)
    first, second = (special, f" It also {usual}." if usual else "") if special else (usual, "")
    first = first or f"leaves something out, {_guesses(findings, everywhere)}"
    there = "" if confirmed is None else f", which held-out time has {as_large(*astuple(confirmed))}"
    return (
        f"The {model} {first}.{second} The unpredicted part of the torque variance on held-out time is {urdf} with the "
        f"{model}, {rigid} with a re-fitted rigid body and {extended} with what was found{there}.{open_end}"
    )


def ended_statement(terms: int, left: str) -> str:
    """Say that a search has ended with so many terms before what is likelier than not; nothing if nothing is left."""
    if not left:
        return ""
    count = f"{terms} term{'' if terms == 1 else 's'}"
    return f"The search ends with {count}, though more is likelier than not beside them: first of all {left}."


def unfinished() -> str:
    """Say that the search was ended early, if it was."""
    return f"Unfinished: the search ended {reason_words()}, and more may be missing." if stopped() else ""


def suspect_statement(suspected: Suspicions) -> str:
    """Say that the input is not to be trusted, why, and what was tested."""
    told = [one for one in suspected.found if one.settles]
    tested = f"Tested were {joined(suspected.tested)}" if suspected.tested else ""
    if told:
        reasons = "; ".join(one.statement for one in told)
        return (
            f"The recordings do not mean what they say, or are not of this robot: {reasons}. Nothing is told of the "
            f"robot before that is settled. {tested}."
        )
    none = "; none of them explains the torques far better." if suspected.tested else ""
    return (
        "The model with what was found predicts held-out torque no better than a constant, so that there is nothing to "
        "tell: the recordings are not what they say, are not of this robot, or move too little. "
        f"{tested}{none}"
    )


REFUTED = (
    "What else explains the time that was fitted predicts held-out time worse than ordinary friction alone does, and "
    "is not in the model: it is too little to be told, or the robot, its load or its motion was another there."
)
"""Said where held-out time refutes what was found."""


def _told(findings: Sequence[Finding], everywhere: Sequence[str]) -> str:
    """Return "leaves out ..." and "has the wrong ...", or nothing."""
    wrong = [f for f in findings if _is_wrong(f)]
    parts = {"leaves out": [f for f in findings if f not in wrong], "has the wrong": wrong}
    return " and ".join(f"{verb} {_places(those, everywhere)}" for verb, those in parts.items() if those)


def _guesses(findings: Sequence[Finding], everywhere: Sequence[str]) -> str:
    """Return findings of which none is likelier than not: "perhaps backlash or torque ripple at joint2"."""
    told = []
    for f in findings[:_MOST_NAMED]:
        either = joined(map(_with_article, (*alternatives(f)[:1], named(f))), "or")
        told.append(f"{either}{at(f.joints, f.links, everywhere)}")
    return f"perhaps {joined(told)}"


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
    vowel = words[0] in "aeiou" and not words.startswith("one")
    return f"{'an' if vowel else 'a'} {words}" if counted else words


def _shortened(words: Sequence[str]) -> str:
    """Return "viscous and Coulomb friction" for "viscous friction" and "Coulomb friction"."""
    return words[0] if len(words) == 1 else joined(w.removesuffix(" friction") for w in words) + " friction"
