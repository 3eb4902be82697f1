"""Verdicts, numbers and places as a person reads them."""

from __future__ import annotations

import math

from torchrbd.diagnosis.results import Diagnosis, Where
from torchrbd.diagnosis.words import MINUS, number
from torchrbd.inference.results import Identification

VERDICTS = {
    "consistent": "✓ URDF consistent",
    "parameters": "≠ Parameters differ",
    "missing_physics": "! Missing physics",
    "unexplained": "? Unexplained",
    "identified": "✓ Identified",
    "doubtful": "! Identified, with doubts",
    "worse": "✗ Worse than the URDF",
}
"""What a verdict is called, after a sign that tells it without colour."""


def headline(result: Identification | Diagnosis) -> tuple[str, str]:
    """Return the result in one sentence, and what else is to say of it."""
    if isinstance(result, Diagnosis):
        first, stop, rest = result.statement.partition(". ")
        return first + stop.strip(), rest
    mean = {name: fit.mean_nmse for name, fit in result.fits.items()}
    last = list(mean)[-1]
    before, after = mean["urdf"], mean[last]
    subject = "The extended model" if last == "extended" else "Re-fitting"
    name, numbers = result.robot.name, f"mean nmse {number(before)} → {number(after)}"
    rest = f"The rigid body alone, re-fitted, has {number(mean['rigid_body'])}." if last == "extended" else ""
    if not after < before:
        verb = "raises" if result.verdict == "worse" else "does not lower"
        return f"{subject} {verb} the held-out torque error of {name}: {numbers}.", rest
    return f"{subject} lowers the held-out torque error of {name} by {percent(1 - after / before)}: {numbers}.", rest


def plain(value: float) -> str:
    """Return a number in at most four digits, without trailing zeros and with a true minus sign."""
    return f"{float(f'{value:.4g}') + 0.0:g}".replace("-", MINUS)


def measure(value: float, spread: float) -> str:
    """Return ``value ± spread`` with the digits that two significant ones of the spread leave; a dash if unknown."""
    if math.isnan(spread):
        return f"{number(value)} ± –"
    if not (math.isfinite(spread) and spread > 0):
        return number(value)
    digits = 1 - math.floor(math.log10(spread))
    if digits > 6:
        return f"{number(value)} ± {number(spread)}"
    return f"{value:.{max(0, digits)}f} ± {spread:.{max(0, digits)}f}".replace("-", MINUS)


def percent(share: float) -> str:
    """Return a share in per cent; only certainty is 0 or 100, and a dash is what nobody knows."""
    if math.isnan(share):
        return "–"
    if 0.995 <= share < 1.0:
        return "> 99 %"
    return "< 1 %" if 0.0 < share < 0.005 else f"{100 * share:.0f} %"


def change(before: float, after: float) -> str:
    """Return by how much an error fell or rose."""
    if not (before > 0 and math.isfinite(after)):
        return ""
    factor = max(before / after, after / before) if after > 0 else 1.0
    if factor > 100:
        times = f"{float(f'{factor:.2g}'):,.0f}".replace(",", "\N{NARROW NO-BREAK SPACE}")
        return f"{times} times {'less' if after < before else 'more'}"
    return f"{100 * (after / before - 1):+.0f} %".replace("+0 %", "±0 %").replace("-0 %", "±0 %").replace("-", MINUS)


def unit(symbol: str) -> str:
    """Return a unit with its powers raised, e.g. "kg m²"."""
    return symbol.replace("^2", "²").replace("^3", "³")


def tied(sentence: str) -> str:
    """Return a sentence that breaks no line before a per-cent sign, after < or around ±."""
    return (
        sentence.replace(" %", "\N{NO-BREAK SPACE}%")
        .replace("< ", "<\N{NO-BREAK SPACE}")
        .replace(" ± ", "\N{NO-BREAK SPACE}±\N{NO-BREAK SPACE}")
    )


def where_words(where: Where) -> str:
    """Return in which recordings, when and in which region, or nothing for everywhere."""
    parts = [] if where.recordings is None else ["in " + ", ".join(where.recordings)]
    parts += [f"{low:g} to {high:g} s" for low, high in where.time_s or ()]
    parts += [f"{r.signal} from {plain(r.low)} to {plain(r.high)}" for r in where.region or ()]
    return "; ".join(parts)
