"""Numbers, places and effects as a person reads them."""

from __future__ import annotations

import math

from torchrbd.diagnosis.results import Where
from torchrbd.diagnosis.words import MINUS, number


def plain(value: float) -> str:
    """Return a number in at most four digits, without trailing zeros and with a true minus sign."""
    return f"{float(f'{value:.4g}') + 0.0:g}".replace("-", MINUS)


def measure(value: float, spread: float) -> str:
    """Return ``value ± spread`` with the digits that two significant ones of the spread leave."""
    if not (math.isfinite(spread) and spread > 0):
        return number(value)
    digits = 1 - math.floor(math.log10(spread))
    if digits > 6:
        return f"{number(value)} ± {number(spread)}"
    return f"{value:.{max(0, digits)}f} ± {spread:.{max(0, digits)}f}".replace("-", MINUS)


def percent(share: float) -> str:
    """Return a share in per cent; only certainty is 0 or 100."""
    if 0.995 <= share < 1.0:
        return "> 99 %"
    return "< 1 %" if 0.0 < share < 0.005 else f"{100 * share:.0f} %"


def change(before: float, after: float) -> str:
    """Return by how much an error fell or rose."""
    if not (before > 0 and math.isfinite(after)):
        return ""
    if 0 < after < 0.01 * before:
        return f"{float(f'{before / after:.2g}'):,.0f} times less".replace(",", "\N{NARROW NO-BREAK SPACE}")
    return f"{100 * (after / before - 1):+.0f} %".replace("-", MINUS)


def unit(symbol: str) -> str:
    """Return a unit with its powers raised, e.g. "kg m²"."""
    return symbol.replace("^2", "²").replace("^3", "³")


def tied(sentence: str) -> str:
    """Return a sentence that breaks no line before a per-cent sign or around ±."""
    return sentence.replace(" %", "\N{NO-BREAK SPACE}%").replace(" ± ", "\N{NO-BREAK SPACE}±\N{NO-BREAK SPACE}")


def where_words(where: Where) -> str:
    """Return in which recordings, when and in which region, or nothing for everywhere."""
    parts = [] if where.recordings is None else ["in " + ", ".join(where.recordings)]
    parts += [f"{low:g} to {high:g} s" for low, high in where.time_s or ()]
    parts += [f"{r.signal} from {plain(r.low)} to {plain(r.high)}" for r in where.region or ()]
    return "; ".join(parts)
