"""Rates, means and medians with honest 95 % intervals, and tables of them in Markdown."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import binom

_NORMAL_95 = 1.96
_RESAMPLES = 2000


@dataclass(frozen=True)
class Figure:
    """A number with its 95 % interval, from ``n`` observations; NaN without any."""

    value: float
    low: float
    high: float
    n: int

    def __str__(self) -> str:
        if self.n == 0:
            return "–"
        return f"{_text(self.value)} ({_text(self.low)} to {_text(self.high)})"


NOTHING = Figure(math.nan, math.nan, math.nan, 0)


def _text(value: float) -> str:
    return "none" if math.isinf(value) else f"{value:.2g}" if abs(value) < 0.1 else f"{value:.3g}"


def wilson(part: float, n: float) -> tuple[float, float]:
    """Return Wilson's 95 % interval of a rate ``part`` seen in n trials; n need not be whole."""
    z2 = _NORMAL_95**2
    centre = (part + z2 / (2 * n)) / (1 + z2 / n)
    half = _NORMAL_95 / (1 + z2 / n) * math.sqrt(part * (1 - part) / n + z2 / (4 * n * n))
    # At 0 and 1 the end is the rate itself but for rounding.
    return min(part, max(0.0, centre - half)), max(part, min(1.0, centre + half))


def rate(hits: Iterable[bool | None]) -> Figure:
    """Return how many of some are true, leaving out None."""
    told = [h for h in hits if h is not None]
    if not told:
        return NOTHING
    part = sum(told) / len(told)
    return Figure(part, *wilson(part, len(told)), len(told))


def share(hits: Sequence[float], totals: Sequence[float]) -> Figure:
    """Return sum(hits) / sum(totals) of what comes several to a case, both (n_cases,)."""
    k, n = np.asarray(hits, dtype=float), np.asarray(totals, dtype=float)
    if n.sum() == 0:
        return NOTHING
    part, cases = float(k.sum() / n.sum()), int((n > 0).sum())
    scatter = float(((k - part * n) ** 2).sum()) / n.sum() ** 2
    independent = min(part * (1 - part) / scatter, n.sum()) if scatter > 0 else cases
    return Figure(part, *wilson(part, independent), int(n.sum()))


def mean(values: Sequence[float]) -> Figure:
    """Return a mean over cases with its bootstrap interval."""
    if not len(values):
        return NOTHING
    drawn = np.random.default_rng(0).choice(np.asarray(values, dtype=float), (_RESAMPLES, len(values))).mean(1)
    low, high = np.quantile(drawn, (0.025, 0.975)).tolist()
    return Figure(float(np.mean(values)), low, high, len(values))


def median(values: Iterable[float | None]) -> Figure:
    """Return a median with the interval of its ranks, leaving out None."""
    told = np.sort([v for v in values if v is not None])
    n = len(told)
    if n == 0:
        return NOTHING
    below = int(binom.ppf(0.025, n, 0.5))
    # Between a number and infinity numpy finds no middle.
    middle = told[n // 2] if math.isinf(told[n // 2]) else np.median(told)
    return Figure(float(middle), float(told[max(below - 1, 0)]), float(told[min(n - below, n - 1)]), n)


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a Markdown table."""
    return "\n".join("| " + " | ".join(row) + " |" for row in (head, ["---"] * len(head), *rows))
