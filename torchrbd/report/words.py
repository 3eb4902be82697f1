"""Verdicts, numbers and places as a person reads them."""

from __future__ import annotations

import math

from torchrbd.diagnosis.numbers import MINUS, joined, number
from torchrbd.diagnosis.numbers import percent as exact_percent
from torchrbd.diagnosis.results import Diagnosis, Ratio
from torchrbd.inference.results import Identification

VERDICTS = {
    "consistent": "✓ URDF consistent",
    "parameters": "≠ Parameters differ",
    "missing_physics": "! Missing physics",
    "unexplained": "? Unexplained",
    "identified": "✓ Identified",
    "doubtful": "! Identified, with doubts",
    "worse": "✗ Worse than the URDF",
    "suspect": "✗ Suspect input",
}
"""What a verdict is called, after a sign that tells it without colour."""
# Joints that one line names.
_MOST_NAMED = 3


def model_words(result: Identification | Diagnosis) -> str:
    """Return what the recordings are compared with."""
    return "simulation" if isinstance(result, Diagnosis) and result.simulated else "URDF"


def badge(result: Identification | Diagnosis) -> str:
    """Return what a result's verdict is called."""
    words = VERDICTS[result.verdict].replace("URDF", model_words(result))
    return words if result.finished else f"{words} (unfinished)"


def headline(result: Identification | Diagnosis) -> tuple[str, str]:
    """Return the result in one sentence, and what else is to say of it."""
    if isinstance(result, Diagnosis):
        first, stop, rest = result.statement.partition(". ")
        return first + stop.strip(), rest
    mean = {name: fit.mean_nmse for name, fit in result.fits.items()}
    last = list(mean)[-1]
    before, after = mean["urdf"], mean[last]
    if first := _worst(result, after):
        return first, ""
    subject = "The extended model" if last == "extended" else "Re-fitting"
    name, numbers = result.robot.name, f"mean nmse {number(before)} → {number(after)}"
    rest = f"The rigid body alone, re-fitted, has {number(mean['rigid_body'])}." if last == "extended" else ""
    if not after < before:
        verb = "raises" if result.verdict == "worse" else "does not lower"
        return f"{subject} {verb} the held-out torque error of {name}: {numbers}.", rest
    return f"{subject} lowers the held-out torque error of {name} by {percent(1 - after / before)}: {numbers}.", rest


def _worst(result: Identification, after: float) -> str:
    """Return the sentence on what makes a lower error no praise; nothing where there is none.

    Args:
        result: an identification.
        after: mean nmse of its last model.
    """
    if reasons := [one.statement for one in result.suspicions.found if one.settles]:
        return f"The recordings do not mean what they say, or are not of this robot: {'; '.join(reasons)}."
    if result.verdict == "suspect" or after >= 1.0:
        return (
            f"The fitted model predicts the held-out torque of {result.robot.name} no better than a constant: "
            f"mean nmse {number(after)}."
        )
    if absurd := result.fits["urdf"].absurd:
        return (
            f"Check the units first: the URDF's torque is more than ten times off for {joined(absurd)}. The fitted "
            f"model has a mean nmse of {number(after)}."
        )
    return ""


def suspicion_comments(result: Identification) -> list[str]:
    """Return what a reader of the identified URDF has to know first, if the input is suspected."""
    return [
        f"the recordings are suspect, and these numbers with them: {one.statement}"
        for one in result.suspicions.found
        if one.spoils
    ]


def percent(share: float) -> str:
    """Return a share in per cent; only certainty is 0 or 100, and a dash is what nobody knows."""
    if math.isnan(share):
        return "–"
    if 0.995 <= share < 1.0:
        return "> 99 %"
    return "< 1 %" if 0.0 < share < 0.005 else f"{100 * share:.0f} %"


def part_left(ratio: Ratio) -> str:
    """Return what is left of an error, with its interval: "31 % (25 to 40)"."""
    value, low, high = (exact_percent(x) for x in (ratio.value, ratio.low, ratio.high))
    return f"{value} ({low.removesuffix(' %')} to {high.removesuffix(' %')})"


def worth(result: Diagnosis) -> str:
    """Say in one line what findings leave of the re-fitted rigid body's error, where that is surely less."""
    proofs = result.proofs if result.findings else ()
    if not proofs:
        return ""
    less = sorted(((p.over["rigid_body"], p.joint) for p in proofs), key=lambda pair: pair[0].value)
    less = [(ratio, joint) for ratio, joint in less if ratio.high < 1.0]
    if not less:
        return "The extended model predicts held-out torque at no joint surely better than the re-fitted rigid body."
    if len(less) <= _MOST_NAMED:
        told = joined(f"{part_left(ratio)} at {joint}" for ratio, joint in less)
    else:
        (best, first), (worst, last) = less[0], less[-1]
        ends = f"{part_left(best)} at {first} to {part_left(worst)} at {last}"
        told = f"{ends}, less at {len(less)} of {len(proofs)} joints"
    return f"Of the re-fitted rigid body's squared error on held-out data is left, with 95 % intervals: {told}."


def change(before: float, after: float) -> str:
    """Return by how much an error fell or rose."""
    if not (before > 0 and math.isfinite(after)):
        return ""
    factor = max(before / after, after / before) if after > 0 else 1.0
    if factor > 100:
        times = f"{float(f'{factor:.2g}'):,.0f}".replace(",", "\N{NARROW NO-BREAK SPACE}")
        return f"{times} times {'less' if after < before else 'more'}"
    return f"{100 * (after / before - 1):+.0f} %".replace("+0 %", "±0 %").replace("-0 %", "±0 %").replace("-", MINUS)


def sentence(words: str) -> str:
    """Return words as a sentence: a capital first, a full stop last unless they end with a question mark."""
    return words[:1].upper() + words[1:] + ("" if words.endswith("?") else ".")


def tied(sentence: str) -> str:
    """Return a sentence that breaks no line before a per-cent sign or N m, after < or around ±."""
    return (
        sentence.replace(" %", "\N{NO-BREAK SPACE}%")
        .replace("< ", "<\N{NO-BREAK SPACE}")
        .replace(" N m", "\N{NO-BREAK SPACE}N\N{NO-BREAK SPACE}m")
        .replace("(± ", "(±\N{NO-BREAK SPACE}")
        .replace(" ± ", "\N{NO-BREAK SPACE}±\N{NO-BREAK SPACE}")
    )
