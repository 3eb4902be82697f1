"""Coloured torque noise of one joint: an autoregressive filter, its order chosen by the evidence, with heavy tails.

    e_t = sum_i a_i e_(t-i) + sigma s_t n_t,   n white, normal or Student's t of nu degrees of freedom

s_t is the relative noise of the rows: encoder noise is multiplied by the inertia, and friction is uncertain where the
velocity does not show its direction. All errors have passed the filter of the rows, whatever their cause, so one
predictor is enough. The first rows of a run only predict later ones: equally many for all orders, so that models with
noises of different orders explain the same rows.

Spikes make tails heavy: n_t is Student's t. So do windows of time, or recordings, that are noisier than others: the
rows of a block then share one more factor, and are Student's t together. Student's density of m numbers has a normal
lower bound that touches it at n_0,

    log t(n) >= log N(n; 0, 1/w) + c(w),   w = (nu + m) / (nu + |n_0|^2)

so everything else stays Gaussian, and rows have weights w: Lange, Little and Taylor, "Robust Statistical Modeling Using
the t Distribution", JASA 1989; the bound: Jaakkola and Jordan, "Bayesian parameter estimation via variational methods",
2000.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.special import gammaln

from torchrbd._runtime.filters import unpredicted

_MOST_ORDER = 16
# Noise below this fraction of the residual's RMS is rounding.
_LEAST = 1e-6
# Degrees of freedom of Student's t to try, with a finite variance, and number of steps to find its scale.
_FREEDOMS, _STEPS = (4.0, 10.0), 6


@dataclass(frozen=True)
class Student:
    """Student's t of one joint's M rows, those of one group together.

    Attributes:
        freedom: nu.
        weight: w (M,) of each row, that of its group.
        group: (M,) number of the group of each row; None if each row is its own group.
    """

    freedom: float
    weight: np.ndarray
    group: np.ndarray | None = None

    def at(self, square: np.ndarray, own: np.ndarray | None) -> np.ndarray:
        """Return the weights (m,) for squares n^2 of rows in groups ``own`` (m,); None if each row is its own group."""
        nu = self.freedom
        if own is None:
            return (nu + 1.0) / (nu + square)
        return ((nu + np.bincount(own)) / (nu + np.bincount(own, square)))[own]

    def weighed(self, w: np.ndarray, index: np.ndarray) -> Student:
        """Return a copy with the given weights of its rows (m,)."""
        weight = np.ones(len(self.weight))
        weight[index] = w
        return replace(self, weight=weight)

    def constant(self, index: np.ndarray) -> float:
        """Return sum c(w) of some rows (m,): log of Student's density over that of its normal lower bound at n_0."""
        nu, w, m = self.freedom, self.weight[index], np.ones(1)
        if self.group is not None:
            own = self.group[index]
            m = np.bincount(own)
            of_group = np.ones(len(m))
            of_group[own] = w
            w, m = of_group[m > 0], m[m > 0]
        size = gammaln(0.5 * (nu + m)) - gammaln(0.5 * nu) + 0.5 * (m * math.log(2.0) + nu * math.log(nu))
        each = 0.5 * (nu + m) * (np.log(w / (nu + m)) + 1.0) - 0.5 * nu * w - 0.5 * m * np.log(w)
        return float((size + each).sum())


@dataclass(frozen=True)
class Tail:
    """Heavy tails of one joint's M rows: Student's t of each row, of the rows of each block of time, or of both."""

    parts: tuple[Student, ...]

    @cached_property
    def weight(self) -> np.ndarray:
        """Weight w (M,) of each row."""
        return np.prod([one.weight for one in self.parts], axis=0)

    def constant(self, index: np.ndarray) -> float:
        """Return what the normal densities below those of some rows (m,) lack, see ``Student``."""
        return sum(one.constant(index) for one in self.parts)


@dataclass(frozen=True)
class Noise:
    """The noise of one joint's M rows, m of which are whitened.

    Attributes:
        index: (m,) rows with enough rows before them, see ``predicted``.
        predictor: a (p,).
        sigma: standard deviation of the innovations [N m or N].
        spread: s (M,) of each row.
        tail: its heavy tail, if any.
    """

    index: np.ndarray
    predictor: np.ndarray
    sigma: float
    spread: np.ndarray
    tail: Tail | None = None

    @property
    def scatter(self) -> np.ndarray:
        """Relative standard deviation of the rows, tails included (M,), which sets their weights."""
        return self.spread if self.tail is None else self.spread / np.sqrt(self.tail.weight)

    @property
    def correlation(self) -> np.ndarray:
        """Autocovariance c (p + 1,) of e for innovations of variance one: Yule-Walker equations."""
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

    @cached_property
    def surprise(self) -> float:
        """-log p of the rows, without half the squares of the whitened ones; includes the cost of the order."""
        volume = float(np.log(self.sigma * self.scatter[self.index]).sum())
        heavy = 0.0 if self.tail is None else self.tail.constant(self.index)
        parts = 0 if self.tail is None else len(self.tail.parts)
        return volume - heavy + order_cost(len(self.predictor) + parts, len(self.index))

    def white(self, A: np.ndarray) -> np.ndarray:
        """Return signals (..., M) whitened at rows (m,), (..., m)."""
        out = self.unpredicted(A)
        out /= self.size
        return out

    def unpredicted(self, A: np.ndarray) -> np.ndarray:
        """Return the errors of predicting signals (..., M) at rows (m,) from the rows before, (..., m)."""
        return unpredicted(A, self.predictor, self.index) if len(self.predictor) else A[..., self.index]

    @cached_property
    def size(self) -> np.ndarray:
        """Standard deviation (m,) of the prediction errors [N m or N]."""
        return self.sigma * self.scatter[self.index]


def predicted(run: np.ndarray, measured: np.ndarray) -> np.ndarray:
    """Return the rows (m,) with enough earlier rows in their run for any order, given run (M,) and measured (M,)."""
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
    tail: Tail | None = None,
    white: bool = False,
) -> Noise:
    """Learn the noise from a fit's residual.

    Args:
        residual: (M,) [N m or N].
        index: (m,) rows to whiten.
        spread: s (M,) of each row.
        run: (M,) number of its uninterrupted run.
        used: degrees of freedom that the fit has taken from this joint.
        dispersion: scatter of the blocks over that of white rows; all variances are multiplied by it.
        tail: its heavy tail.
        white: whether rows count as independent, as in least squares.
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
        noise = replace(noise, tail=tail)
        size = float(np.sqrt(np.mean(noise.white(residual) ** 2)))
        noise = replace(noise, sigma=noise.sigma * max(size, _LEAST))
    # The residual of a fit with many parameters is smaller than the noise.
    raised = max(dispersion, 1.0) / max(1.0 - used / count, 0.1)
    return replace(noise, sigma=noise.sigma * math.sqrt(raised))


def tailed(n: np.ndarray, index: np.ndarray, block: np.ndarray, *, normal: bool = False) -> tuple[float, Tail | None]:
    """Return the size of innovations n (m,) at some of M rows, and a heavy tail if the evidence is in favour of one.

    Args:
        n: innovations, divided by the relative noise of their rows.
        index: (m,) their rows.
        block: (M,) number of the block of time of each row.
        normal: whether to try no tail.
    """
    size = float(np.sqrt(np.mean(n**2)))
    best = _loss(n, index, max(size, 1e-150), None), size, None
    if normal or size <= 0:
        return size, None
    each, groups = np.ones(len(block)), {"row": None, "block": block}
    while groups:
        # Tails of rows, or of blocks; then both together.
        others = () if best[2] is None else best[2].parts
        found = [
            (_tailed(n, index, best[1], (*others, Student(nu, each, group))), kind)
            for kind, group in groups.items()
            for nu in _FREEDOMS
        ]
        then, kind = min(found, key=lambda one: one[0][0])
        if then[0] >= best[0]:
            break
        best = then
        del groups[kind]
    return best[1:]


def _tailed(
    n: np.ndarray, index: np.ndarray, size: float, parts: tuple[Student, ...]
) -> tuple[float, float, Tail | None]:
    """Return the loss, the size and the tail of innovations, see ``tailed``, for parts with these degrees of freedom.

    For one part, sum w = m at the best size: dividing by it converges faster (Kent, Tyler and Vardi, "A curious
    likelihood identity for the multivariate t-distribution", Communications in Statistics 1994).
    """
    weights = [one.weight[index] for one in parts]
    groups = [None if one.group is None else one.group[index] for one in parts]

    def weigh() -> np.ndarray:
        """Set each part's weights given those of all others, and return the product of all."""
        square = (n / size) ** 2
        for k, (one, own) in enumerate(zip(parts, groups, strict=True)):
            weights[k] = one.at(math.prod((*weights[:k], *weights[k + 1 :]), start=square), own)
        return np.prod(weights, axis=0)

    for _ in range(_STEPS):
        w = weigh()
        size = math.sqrt(float(w @ n**2) / (float(w.sum()) if len(parts) == 1 else len(n)))
    weigh()
    tail = Tail(tuple(one.weighed(own, index) for one, own in zip(parts, weights, strict=True)))
    return _loss(n, index, size, tail), size, tail


def _loss(n: np.ndarray, index: np.ndarray, size: float, tail: Tail | None) -> float:
    """Return -log p of innovations (m,) of a size, up to a common constant."""
    count, square = len(n), (n / size) ** 2
    if tail is None:
        return count * math.log(size) + 0.5 * float(square.sum())
    w = tail.weight[index]
    volume = count * math.log(size) - 0.5 * float(np.log(w).sum()) - tail.constant(index)
    return volume + 0.5 * float(w @ square) + order_cost(len(tail.parts), count)


def order_cost(order: int, rows: float) -> float:
    """Return the cost of a predictor with so many coefficients [nats]: Schwarz's approximation (BIC).

    Source: Schwarz, "Estimating the Dimension of a Model", Annals of Statistics 1978.
    """
    return 0.5 * order * math.log(max(rows, 1.0))


def predictors(e: np.ndarray, run: np.ndarray, most: int) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield the predictor (p,) of each order up to ``most``, and its prediction errors of a signal (M,).

    The last reflection coefficient of each order minimises the sum of forward and backward prediction errors, so every
    predictor is stable.

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
