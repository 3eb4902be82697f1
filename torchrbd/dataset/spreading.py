"""Tiles that represent all recordings: spread over long ones, with the least sampling rate that suffices."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from torchrbd.dataset.reading import Reading
from torchrbd.recordings import TILE_ROWS, Filtering, States, Survey

# Samples per tile if all are kept, and largest count of numbers in its regressor.
_LONG, _MOST_NUMBERS = 16384, 8_000_000


@dataclass(frozen=True)
class Density:
    """How many samples of states to keep.

    Attributes:
        most_states: approximate largest number, over all tiles.
        least_rate_hz: least number per second, and
        rate_cycles: least number per cycle of the band: features of a motion below the cut-off exceed the band.
    """

    most_states: int
    least_rate_hz: float
    rate_cycles: float

    def tiles(self, reading: Reading, numbers: Sequence[int] | None = None) -> Iterator[tuple[int, States]]:
        """Yield tiles with their recording's number: all of short recordings, some that are spread over long ones."""
        chosen = range(len(reading.recordings)) if numbers is None else numbers
        total, number = sum(self._kept(reading.surveys[k], reading.filtering) for k in chosen), 0
        step = max(1, math.ceil(total / self.most_states))
        # Short tiles spread better, long ones need fewer calls.
        largest = _MOST_NUMBERS // (reading.robot.n_dof * reading.robot.n_params)
        rows = TILE_ROWS if step > 1 else min(_LONG, max(TILE_ROWS, largest))
        for k in chosen:
            for states in reading.tiles(k, rows):
                if number % step == 0:
                    yield k, states
                number += 1

    def thinned(self, states: States, band_hz: float) -> States:
        """Return states at a coarser clock with the same outputs; their torque is noisy: do not use it."""
        return states.thinned(self._thinning(states.stride, states.dt, band_hz))

    def _kept(self, survey: Survey, filtering: Filtering) -> float:
        """Return the approximate number of samples of a recording in all of its tiles."""
        dt = survey.clock.dt
        return survey.duration_s * survey.rate_hz / self._thinning(filtering.stride(dt), dt, filtering.cutoff_hz)

    def _thinning(self, stride: int, dt: float, band_hz: float) -> int:
        least_hz = max(self.least_rate_hz, self.rate_cycles * band_hz)
        most = max(1, math.floor(1.0 / (dt * least_hz) + 1e-6))
        return max(d for d in range(1, most + 1) if stride % d == 0)
