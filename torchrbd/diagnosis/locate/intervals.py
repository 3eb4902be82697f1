"""Scan all intervals of time, or of a signal, for the one in which features explain the leftover.

A feature phi that acts where a <= v < b has the whitened column S_a - S_b, with S_a that of phi 1[v >= a]. So the
normal equations of all intervals follow from those of the edges, and each interval's gain in log-likelihood is

    1/2 u' G^-1 u - K/2 log m - log(number of intervals)

the last two terms for the K coefficients and for having searched (Bayesian information criterion; Bonferroni).
Abrupt edges survive the whitening that takes drift away.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from torchrbd.diagnosis.locate.residual import Leftover
from torchrbd.diagnosis.locate.rows import Rows
from torchrbd.diagnosis.locate.signals import LEAST_SHARE

# An interval holds as many samples at least.
LEAST_SAMPLES = 3
MOST_EDGES, MOST_FINE_EDGES, EDGE_S, SIGNAL_EDGES = 64, 320, 0.4, 24


@dataclass(frozen=True)
class Interval:
    """Where features act best: low <= v < high; ``gain`` in log-likelihood units."""

    low: float
    high: float
    gain: float

    def inside(self, v: np.ndarray) -> np.ndarray:
        """Return 1 where v lies in the interval, 0 elsewhere."""
        return ((v >= self.low) & (v < self.high)).astype(float)


NONE = Interval(-np.inf, np.inf, -np.inf)


def best_interval(
    leftover: Leftover,
    phi: Mapping[int, np.ndarray],
    steps: np.ndarray,
    lows: np.ndarray,
    highs: np.ndarray,
    allowed: np.ndarray,
    searched: int,
) -> Interval:
    """Return the interval with the largest gain.

    Args:
        leftover: what is explained.
        phi: features (M, K) by joint; their coefficients are the same at all joints.
        steps: (M, A + B) for each of the edges, ``lows`` (A,) before ``highs`` (B,), 0 before it and 1 after.
        lows, highs: edges to try.
        allowed: (A, B) bool, the pairs to try.
        searched: number of intervals that the search counts.
    """
    K, m, A = next(iter(phi.values())).shape[1], 0, len(lows)
    columns = {}
    for joint, features in phi.items():
        S = steps if K == 1 and (features == 1).all() else steps[:, :, None] * features[:, None, :]
        columns[joint] = leftover.white(joint, S.reshape(len(steps), -1))
        m += len(columns[joint])
    *grams, u = leftover.equations(columns)
    held = steps.sum(0)
    i, k = np.nonzero(allowed & (held[:A, None] - held[A:] >= LEAST_SAMPLES))
    if not len(i):
        return NONE
    a, b, u = i, A + k, u.reshape(-1, K)
    blocks = [G.reshape(len(u), K, len(u), K).transpose(0, 2, 1, 3) for G in grams]
    own = [G[np.arange(len(u)), np.arange(len(u))] for G in blocks]
    g, alone = (o[a] + o[b] - G[a, b] - G[b, a] for o, G in zip(own, blocks, strict=True))
    size = np.sqrt(np.maximum(np.einsum("pkk->pk", alone), 1e-300))
    score = (u[a] - u[b]) / size
    g = g / (size[:, :, None] * size[:, None, :]) + LEAST_SHARE * np.eye(K)
    told = score / g[..., 0] if K == 1 else np.linalg.solve(g, score[..., None])[..., 0]
    gain = 0.5 * (score * told).sum(1) - 0.5 * K * np.log(max(m, 2)) - np.log(max(searched, 1))
    best = int(np.argmax(gain))
    return Interval(float(lows[i[best]]), float(highs[k[best]]), float(gain[best]))


@dataclass(frozen=True)
class Grid:
    """Edges of stretches to try.

    Attributes:
        lows, highs: where they begin and end on the axis [s].
        allowed: bool, which pairs of the two.
        step: time between two edges [s].
        steps: (M, edges) what begins at each of ``lows``, then of ``highs``.
    """

    lows: np.ndarray
    highs: np.ndarray
    allowed: np.ndarray
    step: float
    steps: np.ndarray

    @property
    def count(self) -> int:
        """Number of stretches."""
        return max(1, int((self.allowed & (self.lows[:, None] < self.highs)).sum()))


class Clock:
    """One axis for the time of all recordings, one after the other, and the edges to try on it.

    Attributes:
        axis: (M,) position of each sample [s].
        starts, ends: where recordings begin and end on the axis, a filter's reach beyond their samples.
        coarse, fine: edges for several features at once, and for one: where noise drifts, the whitened trace of a step
            is as narrow as a sample.
    """

    def __init__(self, rows: Rows) -> None:
        self.rows = rows
        self.numbers = np.unique(rows.recording)
        times = [rows.t[rows.recording == k] for k in self.numbers]
        first, last = np.array([t.min() for t in times]), np.array([t.max() for t in times])
        self._reach = float(rows.rise[0][-1]) + rows.dt
        self.starts = np.cumsum([0.0, *(last - first + 2.1 * self._reach)[:-1]])
        self.ends = self.starts + last - first + 2 * self._reach
        self.shift = self.starts + self._reach - first
        self.axis = rows.t + self.shift[np.searchsorted(self.numbers, rows.recording)]
        total = float((last - first).sum())
        self.coarse = self._grid(max(EDGE_S, 2 * rows.dt, total / MOST_EDGES))
        self.fine = self._grid(max(rows.dt, total / MOST_FINE_EDGES))

    def _grid(self, step: float) -> Grid:
        inner = [
            np.arange(a + self._reach + step, b - self._reach - step / 2, step)
            for a, b in zip(self.starts, self.ends, strict=True)
        ]
        lows = np.concatenate([[a, *grid] for a, grid in zip(self.starts, inner, strict=True)])
        highs = np.concatenate([[*grid, b] for b, grid in zip(self.ends, inner, strict=True)])
        whole = np.isin(lows, self.starts)[:, None] & np.isin(highs, self.ends)
        # All of the only recording is no stretch of time.
        allowed = (self._owner(lows)[:, None] == self._owner(highs)) & ~(whole & (len(inner) == 1))
        return Grid(lows, highs, allowed, step, self._steps(lows, highs))

    def _steps(self, lows: np.ndarray, highs: np.ndarray) -> np.ndarray:
        return self.rows.since(self.axis[:, None] - np.concatenate((lows, highs)))

    def _owner(self, edges: np.ndarray | float) -> np.ndarray:
        return np.searchsorted(self.starts, edges, side="right") - 1

    def inside(self, stretch: Interval) -> np.ndarray:
        """Return 1 within a stretch and 0 outside, as the filter leaves it, (M, 1)."""
        return (self.rows.since(self.axis - stretch.low) - self.rows.since(self.axis - stretch.high))[:, None]

    def scan(self, leftover: Leftover, phi: Mapping[int, np.ndarray]) -> Interval:
        """Return the stretch of one recording in which features act best."""
        grid = self.fine if next(iter(phi.values())).shape[1] == 1 else self.coarse
        count = self.fine.count
        found = best_interval(leftover, phi, grid.steps, grid.lows, grid.highs, grid.allowed, count)
        if found.gain <= 0:
            return found
        k, reach = self._owner(found.low), 1.2 * grid.step
        for spacing in (grid.step / 4, self.rows.dt / 4):
            near = np.arange(-reach, reach + spacing / 2, spacing)
            low, high = found.low + near, found.high + near
            low = np.array([found.low]) if found.low in self.starts else low[low > self.starts[k]]
            high = np.array([found.high]) if found.high in self.ends else high[high < self.ends[k]]
            every = np.ones((len(low), len(high)), dtype=bool)
            finer = best_interval(leftover, phi, self._steps(low, high), low, high, every, count)
            found, reach = (finer if finer.gain > found.gain else found), spacing
        return found

    def place(self, stretch: Interval) -> tuple[str, tuple[float, float] | None]:
        """Return the recording of a stretch, and its begin and end there [s], None if it is all of it."""
        k = int(self._owner(stretch.low))
        begins, ends = stretch.low in self.starts, stretch.high in self.ends
        t = self.rows.t[self.rows.recording == self.numbers[k]]
        low = float(t.min()) if begins else stretch.low - float(self.shift[k])
        high = float(t.max()) if ends else stretch.high - float(self.shift[k])
        return self.rows.recordings[self.numbers[k]], None if begins and ends else (round(low, 2), round(high, 2))


def signal_interval(leftover: Leftover, joint: int, phi: np.ndarray, v: np.ndarray) -> Interval:
    """Return the interval of a signal v (M,) in which features (M, K) act best.

    Edges lie at quantiles first and then, near the best ones, four times as dense.
    """
    levels = np.linspace(0, 1, SIGNAL_EDGES + 1)

    def best(low: np.ndarray, high: np.ndarray) -> Interval:
        low, high = (np.unique(np.quantile(v, part.clip(0, 1))) for part in (low, high))
        high = np.where(high >= v.max(), np.inf, high)
        allowed = ~((low[:, None] <= v.min()) & np.isinf(high))
        steps = (v[:, None] >= np.concatenate((low, high))).astype(float)
        count = SIGNAL_EDGES * (SIGNAL_EDGES + 1) // 2
        return best_interval(leftover, {joint: phi}, steps, low, high, allowed, count)

    coarse = best(levels[:-1], levels[1:])
    if not np.isfinite(coarse.gain):
        return coarse
    near = np.arange(-1.0, 1.01, 0.25) / SIGNAL_EDGES
    low, high = float(np.mean(v < coarse.low)), float(np.mean(v < coarse.high))
    fine = best(low + near if low > 0 else np.zeros(1), high + near if high < 1 else np.ones(1))
    return fine if fine.gain > coarse.gain else coarse
