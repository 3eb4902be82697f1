"""Scan all intervals of time, or of a signal, for the one in which features explain the residual.

A feature phi that acts where a <= v < b has the whitened column S_a - S_b, with S_a that of phi 1[v >= a]. So the
normal equations of all intervals follow from those of the edges, and each interval's gain in log-likelihood is

    1/2 u' G^-1 u - K/2 log m - log(number of intervals)

The last two terms are the cost of the K coefficients and of the search (Bayesian information criterion; Bonferroni).
Abrupt edges survive the whitening, which removes drift.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from torchrbd.diagnosis.locate.edges import edge_equations
from torchrbd.diagnosis.locate.signals import LEAST_SHARE
from torchrbd.diagnosis.rows.regression import Fit

# An interval holds as many samples at least.
LEAST_SAMPLES = 3
SIGNAL_EDGES = 24
# Where features have less than this part of the power of the largest interval, their gain is rounding.
_LEAST_POWER = 1e-6


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


def gains(
    fit: Fit, phi: Mapping[int, np.ndarray], steps: np.ndarray, allowed: np.ndarray, searched: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the gains of intervals between edges.

    Args:
        fit: whose residual is explained.
        phi: features (K, M) by joint; their coefficients are the same at all joints.
        steps: (E, M) for each edge 0 before it and 1 after.
        allowed: (E, E) bool, which pairs of edges to try, from the first to the second.
        searched: number of intervals that the search counts.

    Returns:
        Numbers (P,) of first and second edges, and gains (P,).
    """
    K = len(next(iter(phi.values())))
    G, alone, u = edge_equations(fit, phi, steps)
    m = sum(fit.rows.counts[j] for j in phi)
    held = steps.sum(1)
    a, b = np.nonzero(allowed & (held[:, None] - held >= LEAST_SAMPLES))
    power = _between(alone.diagonal(axis1=1, axis2=3), a, b)
    size = np.sqrt(np.maximum(power, _LEAST_POWER * max(float(power.max(initial=0.0)), 1e-300)))
    score = (u[a] - u[b]) / size
    if K == 1:
        g = _between(G[:, 0], a, b) / size**2 + LEAST_SHARE
        coefficients = score / g
    else:
        g = _between(G.transpose(0, 2, 1, 3), a, b) / (size[:, :, None] * size[:, None]) + LEAST_SHARE * np.eye(K)
        coefficients = np.linalg.solve(g, score[..., None])[..., 0]
    return a, b, 0.5 * (score * coefficients).sum(1) - 0.5 * K * np.log(max(m, 2)) - np.log(max(searched, 1))


def _between(G: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the products of S_a - S_b with themselves from those of all S, (E, E, ...)."""
    own = G[np.arange(len(G)), np.arange(len(G))]
    cross = G[a, b]
    return own[a] + own[b] - cross - (cross if G.ndim < 4 else cross.swapaxes(-1, -2))


def best_interval(
    fit: Fit, phi: Mapping[int, np.ndarray], edges: np.ndarray, steps: np.ndarray, allowed: np.ndarray, searched: int
) -> Interval:
    """Return the interval with the largest gain; ``edges`` (E,), else as in ``gains``."""
    a, b, gain = gains(fit, phi, steps, allowed, searched)
    if not len(gain):
        return NONE
    best = int(np.argmax(gain))
    return Interval(float(edges[a[best]]), float(edges[b[best]]), float(gain[best]))


def signal_interval(fit: Fit, joint: int, phi: np.ndarray, v: np.ndarray) -> Interval:
    """Return the interval of a signal v (M,) in which features (K, M) act best.

    Edges lie at quantiles first and then, near the best ones, four times as dense.
    """
    count = SIGNAL_EDGES * (SIGNAL_EDGES + 1) // 2

    def best(low: np.ndarray, high: np.ndarray) -> Interval:
        low, high = (np.unique(np.quantile(v, part.clip(0, 1))) for part in (low, high))
        high = np.where(high >= v.max(), np.inf, high)
        edges = np.unique((*low, *high))
        allowed = np.isin(edges, low)[:, None] & np.isin(edges, high) & (edges[:, None] < edges)
        allowed &= ~((edges[:, None] <= v.min()) & np.isinf(edges))
        return best_interval(fit, {joint: phi}, edges, (v >= edges[:, None]).astype(float), allowed, count)

    levels = np.linspace(0, 1, SIGNAL_EDGES + 1)
    coarse = best(levels[:-1], levels[1:])
    if not np.isfinite(coarse.gain):
        return coarse
    near = np.arange(-1.0, 1.01, 0.25) / SIGNAL_EDGES
    low, high = float(np.mean(v < coarse.low)), float(np.mean(v < coarse.high))
    fine = best(low + near if low > 0 else np.zeros(1), high + near if high < 1 else np.ones(1))
    return fine if fine.gain > coarse.gain else coarse
