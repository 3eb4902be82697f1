"""How well reported times and signal ranges agree with the true ones."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

Json = Mapping[str, Any]
Interval = tuple[float, float]


def interval_iou(a: Sequence[Interval], b: Sequence[Interval]) -> float:
    """Return the overlap over the union of two sets of intervals, each without overlaps of its own."""
    common = math.fsum(max(0.0, min(x[1], y[1]) - max(x[0], y[0])) for x in a for y in b)
    total = math.fsum(end - start for start, end in (*a, *b)) - common
    return common / total if total > 0 else 0.0


def end_errors(true: Sequence[Interval], told: Sequence[Interval]) -> tuple[float, ...]:
    """Return the errors of both ends of each true interval, by the told one that overlaps it most; infinite without."""
    errors: list[float] = []
    for start, end in true:
        near = max(told, key=lambda p: min(p[1], end) - max(p[0], start), default=None)
        if near is None or min(near[1], end) <= max(near[0], start):
            errors += [math.inf, math.inf]
        else:
            errors += [abs(near[0] - start), abs(near[1] - end)]
    return tuple(errors)


def region_iou(true: Sequence[Json], told: Sequence[Json]) -> float:
    """Return the mean over the true region's signals of overlap over union; zero for a signal that is not told.

    A region that is open to one side ends where the other one does.
    """
    ranges = {r["signal"]: r for r in told}
    shares = []
    for r in true:
        other = ranges.get(r["signal"])
        if other is None:
            shares.append(0.0)
            continue
        a, b = ([mine[end] if mine[end] is not None else its[end] for end in ("low", "high")]
                for mine, its in ((r, other), (other, r)))  # fmt: skip
        shares.append(interval_iou([(a[0], a[1])], [(b[0], b[1])]))
    return math.fsum(shares) / len(shares)
