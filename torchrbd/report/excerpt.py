"""What of the series a figure shows: the most informative window of time and signal, and means in bins."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from torchrbd.inference.results import TorqueSeries
from torchrbd.report.text.locations import excerpt_words

WINDOW_S = 15.0
SIGNALS = {"q": "position", "qd": "velocity", "qdd": "acceleration"}


@dataclass(frozen=True)
class Excerpt:
    """Samples ``index`` of one recording that a figure shows, and where they lie, in words."""

    recording: str
    index: np.ndarray
    words: str


def informative_excerpt(series: TorqueSeries, joint: int, model: str) -> Excerpt:
    """Return the 15 s of held-out data in which ``model`` leaves the largest residual at a joint."""
    energy = np.nan_to_num(series.residual(model)[:, joint] ** 2)
    energy = np.where(series.held_out, energy, 0.0) if (energy * series.held_out).any() else energy
    best, score = Excerpt("", np.zeros(0, dtype=int), ""), -1.0
    for r, name in enumerate(series.recordings):
        rows = np.flatnonzero(series.recording == r)
        if not rows.size:
            continue
        t = series.t[rows]
        start = np.flatnonzero(t <= max(t[-1] - WINDOW_S, t[0]))
        end = np.searchsorted(t, t[start] + WINDOW_S, side="right")
        total = np.concatenate([[0.0], np.cumsum(energy[rows])])
        k = int(np.argmax(total[end] - total[start]))
        if total[end[k]] - total[start[k]] > score:
            score, index = total[end[k]] - total[start[k]], rows[start[k] : end[k]]
            whole = len(index) == len(rows)
            best = Excerpt(
                name, index, name if whole else excerpt_words(name, float(t[start[k]]), float(t[end[k] - 1]))
            )
    return best


def binned_mean(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return centre, mean, its standard error and count of up to 25 equal bins of x, zero on an edge.

    Neighbouring samples are not independent, so the error counts visits to a bin, not samples: with the sum s_v of
    the deviations of visit v of V from the mean of its bin of n samples, it is sqrt(V / (V - 1) sum_v s_v^2) / n, and
    NaN after a single visit. Bins of fewer than five samples are left out.
    """
    low, high = np.quantile(x, [0.005, 0.995])
    width = (high - low) / np.clip(len(x) // 12, 2, 24) or 1.0
    first, last = np.floor(low / width), np.ceil(high / width)  # a jump at zero, as friction has, lies between bins
    which = np.clip(np.floor(x / width) - first, 0, last - first).astype(int)
    count = np.bincount(which)
    mean = np.bincount(which, y) / np.maximum(count, 1)
    start = np.flatnonzero(np.diff(which, prepend=-1))
    deviation = np.add.reduceat(y - mean[which], start)
    visits = np.bincount(which[start]).astype(float)
    visits[visits < 2] = np.nan
    error = np.sqrt(np.bincount(which[start], deviation**2) * visits / (visits - 1)) / np.maximum(count, 1)
    centre = (first + np.arange(len(count)) + 0.5) * width
    kept = count >= 5
    return centre[kept], mean[kept], error[kept], count[kept]


def shown_rows(series: TorqueSeries, joint: int) -> np.ndarray:
    """Return the held-out samples that have a measured torque, or all that have one if none is held out."""
    measured = np.isfinite(series.measured[:, joint])
    held_out = measured & series.held_out
    return np.flatnonzero(held_out if held_out.any() else measured)


def telling_signal(series: TorqueSeries, joint: int, model: str) -> str:
    """Return which of q, qd and qdd of a joint its residual follows most: the largest variance of binned means."""
    rows = shown_rows(series, joint)
    residual = series.residual(model)[rows, joint]

    def share(signal: str) -> float:
        _, mean, _, count = binned_mean(getattr(series, signal)[rows, joint], residual)
        return float(np.cov(mean, fweights=count, ddof=0)) if len(count) else 0.0

    return max(SIGNALS, key=share)


def signal_words(series: TorqueSeries, joint: int, signal: tuple[str, int]) -> str:
    """Return e.g. "velocity", or "velocity of joint2" if that is another joint's."""
    return SIGNALS[signal[0]] + ("" if signal[1] == joint else f" of {series.joints[signal[1]]}")
