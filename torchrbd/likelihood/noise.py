"""Coloured torque noise of one joint: an autoregressive filter whose order the evidence chooses.

    e_t = s_t u_t,   u_t = sum_i a_i u_(t-i) + sigma n_t,   n white

s_t says which rows are noisier than others: encoder noise counts by the inertia that it is multiplied with.

A row is whitened by predicting its error from those before it; a run's first rows only predict: as many whatever the
order, so that models with noises of different orders explain the same rows.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import solve_toeplitz

_MOST_ORDER = 16
# Noise below this part of the residual's RMS is rounding.
_LEAST = 1e-6


@dataclass(frozen=True)
class Noise:
    """The noise of one joint's rows: predictor a (p,), innovation's standard deviation sigma [N m or N], s (M,)."""

    predictor: np.ndarray
    sigma: float
    scale: np.ndarray

    def index(self, run: np.ndarray, measured: np.ndarray) -> np.ndarray:
        """Return the rows (m,) with enough before them in their run for any order, of run (M,) and measured (M,)."""
        p = max(_MOST_ORDER, len(self.predictor))
        k = np.arange(p, len(run))
        return k[(run[k] == run[k - p]) & measured[k] & measured[k - p]]

    def white(self, A: np.ndarray, index: np.ndarray) -> np.ndarray:
        """Return signals (..., M) as the whitened rows (m,) see them, (..., m)."""
        A = A / self.scale
        out = A[..., index]
        for i, a_i in enumerate(self.predictor, start=1):
            out -= a_i * A[..., index - i]
        return out / self.sigma


def learnt(
    residual: np.ndarray, scale: np.ndarray, run: np.ndarray, measured: np.ndarray, used: float, dispersion: float
) -> Noise:
    """Learn the noise from what a fit leaves.

    Args:
        residual: (M,) [N m or N].
        scale: (M,) of the rows, relative to each other.
        run: (M,) number of its uninterrupted run.
        measured: (M,) bool.
        used: degrees of freedom that the fit has taken from this joint.
        dispersion: how much more the blocks scatter than white rows would; the variance is raised by it.
    """
    e = np.where(measured, residual / scale, 0.0)
    count = max(int(measured.sum()), 1)
    lags = autocovariance(e, run, _MOST_ORDER) / count
    # A fit that has many parameters leaves less than the noise.
    left = max(1.0 - used / count, 0.1)
    lags[0] = max(lags[0] * (1 + _LEAST**2), 1e-300)
    best, found = math.inf, Noise(np.zeros(0), math.sqrt(lags[0] / left), scale)
    for p in range(_MOST_ORDER + 1):
        a = solve_toeplitz(lags[:p], lags[1 : p + 1]) if p else np.zeros(0)
        variance = float(lags[0] - a @ lags[1 : p + 1])
        if variance <= 0:
            break
        # Schwarz's approximation of the evidence of the order.
        loss = 0.5 * count * math.log(variance) + 0.5 * p * math.log(count)
        if loss < best:
            best, found = loss, Noise(a, math.sqrt(variance / left), scale)
    return replace(found, sigma=found.sigma * math.sqrt(max(dispersion, 1.0)))


def autocovariance(e: np.ndarray, run: np.ndarray, order: int) -> np.ndarray:
    """Return sum_t e_t e_(t-k) within runs for k up to ``order``, (order + 1,)."""
    n = len(e)
    return np.array([np.sum(e[k:] * e[: n - k] * (run[k:] == run[: n - k])) for k in range(order + 1)])


def drift_basis(t: np.ndarray, recording: np.ndarray, slowest_hz: float, most: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the lowest frequencies of each recording's time, from its level on, as a drift may hold them.

    Args:
        t: (M,) seconds.
        recording: (M,) number.
        slowest_hz: the highest frequency that counts as drift [Hz].
        most: functions a recording at most.

    Returns:
        cosines (D, M), zero outside of their recording, and the standard deviations (D,) of a random walk's, relative
        to the slowest one's.
    """
    functions, sizes = [], []
    for k in np.unique(recording):
        inside = recording == k
        begin, length = t[inside].min(), max(float(np.ptp(t[inside])), 1e-9)
        for order in range(min(most, max(1, int(2 * length * slowest_hz))) + 1):
            functions.append(np.where(inside, np.cos(math.pi * order * (t - begin) / length), 0.0))
            sizes.append(1.0 / max(order, 1))
    return np.array(functions), np.array(sizes)
