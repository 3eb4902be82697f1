"""Numbers, lists and typography, as a person reads them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

MINUS = "\N{MINUS SIGN}"
# A spread that begins with this or more has one digit; a second would say nothing of the value.
_ONE_DIGIT = 3.55
_MOST_DECIMALS = 6
_KNOWN = {"1": "", "N m s^2/rad": "kg m^2", "N s^2/m": "kg"}
_LEAST_PERCENT = 1e-5


def number(value: float) -> str:
    """Return three significant digits, or a dash where there is no number."""
    if not math.isfinite(value):
        return "–"
    if value == 0 or 1e-4 <= abs(value) < 1e3:
        return (f"{value:#.3g}" if value else "0").rstrip(".").replace("-", MINUS)
    if 1e3 <= abs(value) < 1e6:
        return f"{value:.0f}".replace("-", MINUS)
    mantissa, exponent = f"{value:.2e}".split("e")
    return f"{mantissa}·{power_of_ten(int(exponent))}".replace("-", MINUS)


def power_of_ten(exponent: int) -> str:
    """Return e.g. "10⁻⁵"."""
    return "10" + str(exponent).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))


def plain(value: float, digits: int = 4) -> str:
    """Return a number in at most so many digits, without trailing zeros and with a true minus sign."""
    return f"{float(f'{value:.{digits}g}') + 0.0:g}".replace("-", MINUS)


def measure(value: float, spread: float) -> str:
    """Return ``value ± spread`` with the digits that the spread leaves; a dash if it is unknown.

    The spread has two significant digits from 10 to 35 and one from 36 to 95. What ``number`` writes with a power of
    ten has one here too, of thousands or thousandths: "(13 ± 7)·10⁶".
    """
    if math.isnan(spread):
        return f"{number(value)} ± –"
    if not (math.isfinite(spread) and spread > 0):
        return number(value)
    most = max(abs(value), spread)
    if 1e-4 <= most < 1e6:
        return _digits(value, spread) or f"{number(value)} ± {number(spread)}"
    exponent = 3 * math.floor(math.log10(most) / 3)
    shown = _digits(value / 10.0**exponent, spread / 10.0**exponent)
    return f"({shown})·{power_of_ten(exponent)}" if shown else f"{number(value)} ± {number(spread)}"


def _digits(value: float, spread: float) -> str:
    """Return ``value ± spread`` without powers of ten; nothing if that takes too many digits."""
    exponent = math.floor(math.log10(spread))
    digits = 1 - exponent - (spread / 10.0**exponent >= _ONE_DIGIT)
    if digits > _MOST_DECIMALS:
        return ""
    shown = (f"{round(v, digits) + 0.0:.{max(0, digits)}f}" for v in (value, spread))
    return " ± ".join(shown).replace("-", MINUS)


def percent(part: float) -> str:
    """Return a part of one in per cent, two significant digits."""
    if not math.isfinite(part):
        return "–"
    if 0 < part < _LEAST_PERCENT:
        return f"< {100 * _LEAST_PERCENT:g} %"
    return f"{100 * part:.2g} %" if part < 0.995 else f"{100 * part:.0f} %"


def ratio_with_interval(ratio: float, low: float, high: float, *, of: str) -> str:
    """Return a ratio with its 95 % interval, e.g. "1.02 times the fitted torque (95 %: 0.81 to 1.22)"."""
    value, *ends = (f"{x:.2f}".replace("-", MINUS) for x in (ratio, low, high))
    return f"{value} times {of} (95 %: {' to '.join(ends)})"


def unit(symbol: str) -> str:
    """Return a unit as one reads it, e.g. "kg m²", and nothing for a pure number."""
    return _KNOWN.get(symbol, symbol).replace("^2", "²").replace("^3", "³")


def with_unit(words: str, symbol: str) -> str:
    """Return words and a unit behind them."""
    return f"{words} {unit(symbol)}".rstrip()


def joined(words: Iterable[str], last: str = "and") -> str:
    """Return "a, b and c", every word once; nothing for none."""
    *first, end = dict.fromkeys(words) or ("",)
    return f"{', '.join(first)} {last} {end}" if first else end


def as_many_as_fit(items: Sequence[str], words: int, last: str = "and", rest: str = "more") -> str:
    """Return items joined, as many as so many words hold but one at least, and how many others: "a, b and 3 more"."""
    items = list(dict.fromkeys(items))
    for count in range(len(items), 0, -1):
        others = [_counted(len(items) - count, rest)] if count < len(items) else []
        text = joined([*items[:count], *others], last)
        if len(text.split()) <= words or count == 1:
            return text
    return ""


def _counted(count: int, plural: str) -> str:
    """Return a number and a noun: "1 more effect", "2 more effects"."""
    return f"{count} {plural.removesuffix('s') if count == 1 else plural}"


def capital(words: str) -> str:
    """Return words with a capital first."""
    return words[:1].upper() + words[1:]


def sentence(words: str) -> str:
    """Return words as a sentence: a capital first, a full stop last unless they end with one or a question mark."""
    return capital(words) + ("" if words.endswith(("?", ".")) else ".")


def probability(p: float) -> str:
    """Return a probability in per cent; only certainty is 0 or 100, and a dash is what nobody knows."""
    if math.isnan(p):
        return "–"
    if 0.995 <= p < 1.0:
        return "> 99 %"
    return "< 1 %" if 0.0 < p < 0.005 else f"{100 * p:.0f} %"


def change(before: float, after: float) -> str:
    """Return by how much an error fell or rose."""
    if not (before > 0 and math.isfinite(after)):
        return ""
    factor = max(before / after, after / before) if after > 0 else 1.0
    if factor > 100:
        times = f"{float(f'{factor:.2g}'):,.0f}".replace(",", "\N{NARROW NO-BREAK SPACE}")
        return f"{times} times {'less' if after < before else 'more'}"
    return f"{100 * (after / before - 1):+.0f} %".replace("+0 %", "±0 %").replace("-0 %", "±0 %").replace("-", MINUS)


def tied(sentence: str) -> str:
    """Return a sentence that breaks no line before a per-cent sign or N m, after < or around ±."""
    return (
        sentence.replace(" %", "\N{NO-BREAK SPACE}%")
        .replace("< ", "<\N{NO-BREAK SPACE}")
        .replace(" N m", "\N{NO-BREAK SPACE}N\N{NO-BREAK SPACE}m")
        .replace("(± ", "(±\N{NO-BREAK SPACE}")
        .replace(" ± ", "\N{NO-BREAK SPACE}±\N{NO-BREAK SPACE}")
    )
