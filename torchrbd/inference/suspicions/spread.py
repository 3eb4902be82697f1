"""Tiles that stand for all recordings: spread over long ones, and no finer than their band needs."""

from __future__ import annotations

import math
from collections.abc import Iterator

from torchrbd.inference.preparation import Prepared
from torchrbd.recordings import States

# Samples of states that are looked at, about, and how many a second, at least and for each Hz of the band.
_MOST_STATES, _LEAST_RATE_HZ, _RATE_CYCLES = 30_000, 60.0, 10.0


def spread(prepared: Prepared) -> Iterator[tuple[int, States]]:
    """Yield every tile with its recording's number, or some that are spread over long recordings."""
    reading = prepared.reading
    total = sum(s.duration_s * min(s.rate_hz, _rate(reading.filtering.cutoff_hz)) for s in reading.surveys)
    step, number = max(1, math.ceil(total / _MOST_STATES)), 0
    for k in range(len(reading.recordings)):
        for states in reading.tiles(k):
            if number % step == 0:
                yield k, states
            number += 1


def _rate(band_hz: float) -> float:
    return max(_LEAST_RATE_HZ, _RATE_CYCLES * band_hz)


def thinning(states: States, band_hz: float) -> int:
    """Return by how much a clock may be coarser that has the same outputs."""
    most = max(1, math.floor(1.0 / (states.dt * _rate(band_hz)) + 1e-6))
    return max(d for d in range(1, most + 1) if states.stride % d == 0)
