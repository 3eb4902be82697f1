"""Windows of time: one axis for all recordings, the edges to try on it, and the search for the best window."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from torchrbd.diagnosis.locate.intervals import Interval, best_interval
from torchrbd.diagnosis.locate.scene import Scene
from torchrbd.diagnosis.rows.regression import Fit
from torchrbd.effects import Window

MOST_EDGES, MOST_FINE_EDGES, EDGE_S = 40, 320, 0.4
# How much closer edges lie each time that ends are looked at again.
_ZOOM = 8


@dataclass(frozen=True)
class Grid:
    """Edges of windows to try.

    Attributes:
        edges: (E,) on the axis [s], begins and ends of recordings among them.
        steps: (E, M) what begins at each of them.
        allowed: (E, E) bool, which pairs enclose a window.
        step: time between two edges [s].
    """

    edges: np.ndarray
    steps: np.ndarray
    allowed: np.ndarray
    step: float

    @property
    def count(self) -> int:
        """Number of windows."""
        return max(1, int(self.allowed.sum()))


class Clock:
    """One axis for the time of all recordings, one after the other, and the edges to try on it.

    Attributes:
        axis: (M,) position of each sample [s].
        starts, ends: where recordings begin and end on the axis, a filter's reach beyond their samples.
        coarse, fine: edges for several features at once, and for one: where noise drifts, the whitened trace of a step
            is as narrow as a sample.
    """

    def __init__(self, scene: Scene) -> None:
        self.scene, samples = scene, scene.samples
        self.numbers = np.unique(samples.recording)
        times = [samples.t[samples.recording == k] for k in self.numbers]
        self._first, self._last = np.array([t.min() for t in times]), np.array([t.max() for t in times])
        self._reach = float(samples.rise[0][-1]) + scene.dt
        lengths = self._last - self._first
        self.starts = np.cumsum([0.0, *(lengths + 2.1 * self._reach)[:-1]])
        self.ends = self.starts + lengths + 2 * self._reach
        self.shift = self.starts + self._reach - self._first
        self.axis = samples.t + self.shift[np.searchsorted(self.numbers, samples.recording)]
        self._total = float(lengths.sum())

    @cached_property
    def coarse(self) -> Grid:
        return self._grid(max(EDGE_S, 2 * self.scene.dt, self._total / MOST_EDGES))

    @cached_property
    def fine(self) -> Grid:
        return self._grid(max(self.scene.dt, self._total / MOST_FINE_EDGES))

    def _grid(self, step: float) -> Grid:
        ends = zip(self.starts, self.ends, strict=True)
        reach = self._reach
        parts = [np.array([a, *np.arange(a + reach + step, b - reach - step / 2, step), b]) for a, b in ends]
        edges, owner = np.concatenate(parts), np.repeat(np.arange(len(parts)), list(map(len, parts)))
        allowed = (owner[:, None] == owner) & (edges[:, None] < edges)
        if len(parts) == 1:
            # The whole of the only recording is no window of time.
            allowed[0, -1] = False
        return Grid(edges, self._steps(edges), allowed, step)

    def _steps(self, edges: np.ndarray) -> np.ndarray:
        return self.scene.since(self.axis - edges[:, None])

    def _owner(self, edge: float) -> int:
        return int(np.searchsorted(self.starts, edge, side="right")) - 1

    def inside(self, interval: Interval) -> np.ndarray:
        """Return 1 within a window and 0 outside, as the filter leaves it, (M,)."""
        return self.scene.since(self.axis - interval.low) - self.scene.since(self.axis - interval.high)

    def scan(self, fit: Fit, phi: Mapping[int, np.ndarray]) -> Interval:
        """Return the window of one recording in which features (K, M) at joints act best."""
        grid = self.fine if len(next(iter(phi.values()))) == 1 else self.coarse
        found = best_interval(fit, phi, grid.edges, grid.steps, grid.allowed, self.fine.count)
        return self.sharpened(fit, phi, found, grid.step) if found.gain > 0 else found

    def sharpened(
        self, fit: Fit, phi: Mapping[int, np.ndarray], found: Interval, step: float | None = None
    ) -> Interval:
        """Return a window with its ends to within ``step``; an end that the data does not show is as in ``coarse``."""
        step, dt = step or self.coarse.step, self.scene.dt
        k, reach = self._owner(found.low), 1.2 * step
        for spacing in np.geomspace(step / 4, dt / 4, 1 + max(1, math.ceil(math.log(step / dt, _ZOOM)))):
            near = np.arange(-reach, reach + spacing / 2, spacing)
            low, high = found.low + near, found.high + near
            low = np.array([found.low]) if found.low in self.starts else low[low > self.starts[k]]
            high = np.array([found.high]) if found.high in self.ends else high[high < self.ends[k]]
            edges = np.concatenate((low, high))
            allowed = np.zeros((len(edges), len(edges)), dtype=bool)
            allowed[: len(low), len(low) :] = low[:, None] < high
            finer = best_interval(fit, phi, edges, self._steps(edges), allowed, self.fine.count)
            found, reach = (finer if finer.gain > found.gain else found), spacing
        return found

    def place(self, interval: Interval) -> tuple[str, tuple[float, float] | None]:
        """Return the recording of a window, and its begin and end there [s], None if it is the whole recording."""
        k = self._owner(interval.low)
        begins, ends = interval.low in self.starts, interval.high in self.ends
        low = float(self._first[k]) if begins else interval.low - float(self.shift[k])
        high = float(self._last[k]) if ends else interval.high - float(self.shift[k])
        name = self.scene.samples.recordings[self.numbers[k]]
        return name, None if begins and ends else (round(low, 2), round(high, 2))

    def window(self, interval: Interval) -> Window:
        """Return the axis' window as a ``Window``, open where it begins or ends with its recording."""
        k = self._owner(interval.low)
        low = -np.inf if interval.low in self.starts else interval.low - float(self.shift[k])
        high = np.inf if interval.high in self.ends else interval.high - float(self.shift[k])
        return Window(self.scene.samples.recordings[self.numbers[k]], float(low), float(high))
