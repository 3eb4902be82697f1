"""Coloured torque noise of one joint: an autoregressive filter whose order the evidence chooses.

    e_t = sum_i a_i e_(t-i) + sigma s_t n_t,   n white

s_t says which rows are noisier than others: encoder noise counts by the inertia that it is multiplied with, friction
errs where the velocity does not tell its direction. What rows err by has passed the filter of the rows, whatever made
it, so that one predictor serves. A run's first rows only predict: as many whatever the order, so that models with
noises of different orders explain the same rows.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import convolve1d

_MOST_ORDER = 16
# Noise below this part of the residual's RMS is rounding.
_LEAST = 1e-6


@dataclass(frozen=True)
class Noise:
    """The noise of one joint's M rows, m of which are whitened.

    Attributes:
        index: (m,) rows that have enough before them, see ``predicted``.
        predictor: a (p,).
        sigma: standard deviation of the innovations [N m or N].
        spread: s (M,) of each row.
    """

    index: np.ndarray
    predictor: np.ndarray
    sigma: float
    spread: np.ndarray

    @property
    def correlation(self) -> np.ndarray:
        """Autocovariance c (p + 1,) of e for innovations of variance one: Yule and Walker's equations."""
        p = len(self.predictor)
        A = np.eye(p + 1)
        for k in range(p + 1):
            for i, a_i in enumerate(self.predictor, start=1):
                A[k, abs(k - i)] -= a_i
        return np.linalg.solve(A, np.eye(p + 1)[0])

    @property
    def std(self) -> float:
        """Standard deviation of e where s is one [N m or N]."""
        return self.sigma * math.sqrt(max(float(self.correlation[0]), 1.0))

    @property
    def surprise(self) -> float:
        """-log p of the rows, but for half the squares of the whitened ones: its order is paid for."""
        volume = float(np.log(self.sigma * self.spread[self.index]).sum())
        return volume + order_cost(len(self.predictor), len(self.index))

    def white(self, A: np.ndarray) -> np.ndarray:
        """Return signals (..., M) as the whitened rows (m,) see them, (..., m)."""
        ahead = np.concatenate(([1.0], -self.predictor))
        out = convolve1d(A, ahead, mode="constant", origin=-(len(ahead) // 2))[..., self.index]
        out /= self.sigma * self.spread[self.index]
        return out


def predicted(run: np.ndarray, measured: np.ndarray) -> np.ndarray:
    """Return the rows (m,) with enough before them in their run for any order, of run (M,) and measured (M,)."""
    k = np.arange(_MOST_ORDER, len(run))
    return k[(run[k] == run[k - _MOST_ORDER]) & measured[k] & measured[k - _MOST_ORDER]]


def learnt(
    residual: np.ndarray,
    index: np.ndarray,
    spread: np.ndarray,
    run: np.ndarray,
    used: float,
    dispersion: float,
    *,
    white: bool = False,
) -> Noise:
    """Learn the noise from what a fit leaves.

    Args:
        residual: (M,) [N m or N].
        index: (m,) rows to whiten.
        spread: s (M,) of each row.
        run: (M,) number of its uninterrupted run.
        used: degrees of freedom that the fit has taken from this joint.
        dispersion: how much more the blocks scatter than white rows would; all variances are raised by it.
        white: whether rows are taken to be independent, as least squares does.
    """
    own, count = residual / spread, max(len(index), 1)
    rms = float(np.sqrt(np.mean(own[index] ** 2))) if len(index) else 0.0
    noise = Noise(index, np.zeros(0), max(rms, 1e-150), spread)
    if len(index):

        def loss(order: tuple[np.ndarray, np.ndarray]) -> float:
            a, error = order
            variance = max(float(np.mean(error[index] ** 2)), (_LEAST * noise.sigma) ** 2)
            return 0.5 * len(index) * math.log(variance) + order_cost(len(a), len(index))

        noise = replace(noise, predictor=min(predictors(own, run, 0 if white else _MOST_ORDER), key=loss)[0])
        left = float(np.mean(noise.white(residual) ** 2))
        noise = replace(noise, sigma=noise.sigma * math.sqrt(max(left, _LEAST**2)))
    # A fit that has many parameters leaves less than the noise.
    raised = max(dispersion, 1.0) / max(1.0 - used / count, 0.1)
    return replace(noise, sigma=noise.sigma * math.sqrt(raised))


def order_cost(order: int, rows: float) -> float:
    """Return what a predictor of so many coefficients costs the evidence [nats]: Schwarz's approximation.

    Source: Schwarz, "Estimating the Dimension of a Model", Annals of Statistics 1978.
    """
    return 0.5 * order * math.log(max(rows, 1.0))


def predictors(e: np.ndarray, run: np.ndarray, most: int) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield the predictor (p,) of each order up to ``most``, and what it does not predict of a signal (M,).

    Each order's last reflection coefficient makes the errors of predicting forwards and backwards smallest together, so
    that every predictor is stable.

    Source: Burg, "Maximum Entropy Spectral Analysis", 1967; Kay, "Modern Spectral Estimation" (1988), sec. 7.6.
    """
    a, forward, backward = np.zeros(0), e, e
    yield a, forward
    for p in range(1, most + 1):
        inside = run[p:] == run[:-p]
        f, b = forward[p:] * inside, backward[p - 1 : -1] * inside
        power = float(f @ f + b @ b) * (1 + _LEAST**2)
        if power <= 0:
            return
        k = 2.0 * float(f @ b) / power
        a = np.append(a - k * a[::-1], k)
        forward = np.concatenate((forward[:p], f - k * b))
        backward = np.concatenate((backward[:p], b - k * f))
        yield a, forward


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
