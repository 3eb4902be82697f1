"""Coloured torque noise of one joint: an autoregressive filter whose order the evidence chooses.

    e_t = u_t + x_t,   u_t = sum_i a_i u_(t-i) + sigma s_t n_t,   n white

s_t says which rows are noisier than others (encoder noise counts by the inertia that it is multiplied with), and x_t is
what nobody knows of single rows (friction whose direction the velocity does not tell): its variance is 1/w_t^2 - 1
times that of u. Rows count by w and are whitened by predicting their error from those before, b = (1, -a):

    sum_i b_i w_(t-i) e_(t-i),   variance  sum_ij b_i b_j w_(t-i) w_(t-j) c_|i-j| + c_0 sum_i b_i^2 (1 - w_(t-i)^2)

with c the autocovariance of u. A run's first rows only predict: as many whatever the order, so that models with noises
of different orders explain the same rows.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

_MOST_ORDER = 16
# Noise below this part of the residual's RMS is rounding.
_LEAST = 1e-6


@dataclass(frozen=True)
class Noise:
    """The noise of one joint's rows.

    Attributes:
        predictor: a (p,).
        sigma: standard deviation of the innovations [N m or N].
        spread: s (M,) of each row, 1 on average.
        weight: w (M,), 0 to 1.
    """

    predictor: np.ndarray
    sigma: float
    spread: np.ndarray
    weight: np.ndarray

    @cached_property
    def std(self) -> np.ndarray:
        """Standard deviation of what the rows before do not predict, (M,) [N m or N]."""
        if (self.weight == 1.0).all():
            return self.sigma * self.spread
        b, c = np.concatenate(([1.0], -self.predictor)), self.correlation
        lags = np.arange(len(b))
        w = np.stack([_late(self.weight, k) for k in range(len(b))])
        bw = b[:, None] * w
        relative = ((c[np.abs(lags[:, None] - lags)] @ bw) * bw).sum(0) + c[0] * b**2 @ (1.0 - w**2)
        return self.sigma * self.spread * np.sqrt(np.maximum(relative, 1.0))

    @property
    def correlation(self) -> np.ndarray:
        """Autocovariance c (p + 1,) of u for innovations of variance one: Yule and Walker's equations."""
        p = len(self.predictor)
        A = np.eye(p + 1)
        for k in range(p + 1):
            for i, a_i in enumerate(self.predictor, start=1):
                A[k, abs(k - i)] -= a_i
        return np.linalg.solve(A, np.eye(p + 1)[0])

    def index(self, run: np.ndarray, measured: np.ndarray) -> np.ndarray:
        """Return the rows (m,) with enough before them in their run for any order, of run (M,) and measured (M,)."""
        p = max(_MOST_ORDER, len(self.predictor))
        k = np.arange(p, len(run))
        return k[(run[k] == run[k - p]) & measured[k] & measured[k - p]]

    def surprise(self, index: np.ndarray) -> float:
        """Return -log p of rows (m,), but for half the squares of the whitened ones: its order is paid for."""
        return float(np.log(self.std[index] / self.weight[index]).sum()) + order_cost(len(self.predictor), len(index))

    def white(self, A: np.ndarray, index: np.ndarray) -> np.ndarray:
        """Return signals (..., M) as the whitened rows (m,) see them, (..., m)."""
        A = A * self.weight
        out = A[..., index]
        for i, a_i in enumerate(self.predictor, start=1):
            out -= a_i * A[..., index - i]
        return out / self.std[index]


def learnt(
    residual: np.ndarray,
    spread: np.ndarray,
    weight: np.ndarray,
    run: np.ndarray,
    measured: np.ndarray,
    used: float,
    dispersion: float,
    *,
    white: bool = False,
) -> Noise:
    """Learn the noise from what a fit leaves.

    Args:
        residual: (M,) [N m or N].
        spread, weight: see ``Noise``.
        run: (M,) number of its uninterrupted run.
        measured: (M,) bool.
        used: degrees of freedom that the fit has taken from this joint.
        dispersion: how much more the blocks scatter than white rows would; all variances are raised by it.
        white: whether rows are taken to be independent, as least squares does.
    """
    own = np.where(measured, weight / spread, 0.0)
    count = max(float((own**2).sum()), 1.0)
    rms = math.sqrt(max(float(((own * residual) ** 2).sum()) / count, 1e-300))
    noise = Noise(np.zeros(0), rms, spread, weight)
    if len(index := noise.index(run, measured)):
        orders = predictors(own * residual, run, 0 if white else _MOST_ORDER)

        def loss(order: tuple[np.ndarray, np.ndarray]) -> float:
            a, error = order
            variance = max(float(np.mean(error[index] ** 2)), (_LEAST * rms) ** 2)
            return 0.5 * len(index) * math.log(variance) + order_cost(len(a), len(index))

        noise = replace(noise, predictor=min(orders, key=loss)[0])
        left = float(np.mean(noise.white(residual, index) ** 2))
        noise = replace(noise, sigma=rms * math.sqrt(max(left, _LEAST**2)))
    # A fit that has many parameters leaves less than the noise.
    raised = max(dispersion, 1.0) / max(1.0 - used / count, 0.1)
    return replace(noise, sigma=noise.sigma * math.sqrt(raised))


def order_cost(order: int, rows: float) -> float:
    """Return what a predictor of so many coefficients costs the evidence [nats]: Schwarz's approximation.

    Source: Schwarz, "Estimating the Dimension of a Model", Annals of Statistics 1978.
    """
    return 0.5 * order * math.log(max(rows, 1.0))


def _late(x: np.ndarray, steps: int) -> np.ndarray:
    """Return x (M,) so many steps later, the first value before its beginning."""
    return x if not steps else np.concatenate((np.full(steps, x[0]), x[:-steps]))


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
