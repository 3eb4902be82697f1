"""The linear-Gaussian posterior of whitened rows, and the evidence of columns that are added to it.

In coordinates z ~ N(0, 1) and with whitened rows y = X z + n,

    H = X'X + 1 = L L',   z^ = H^-1 X'y,   log p(y) = -1/2 (y'y - z^'X'y) - sum log L_kk + const

Columns C with coefficients w ~ N(0, D^2) have, beside it, precision S = C'C - V'V with V = L^-1 X'C and score
r = C'(y - X z^), and raise the log marginal likelihood by

    log B = 1/2 r'D (1 + D S D)^-1 D r - 1/2 log det(1 + D S D)

which counts the Occam factor of a proper prior: MacKay, "Information Theory, Inference, and Learning Algorithms"
(2003), ch. 28. A coefficient that physics keeps from being negative has a half-normal prior: its posterior's
probability of being positive, over that of the prior, multiplies B.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.linalg import cho_solve, solve_triangular
from scipy.special import log_ndtr

from torchrbd.likelihood.physical import Quadratic

_ROUNDING = 1e-13
# Sweeps over the sites of truncated coefficients, and the least part of its variance that a truncation leaves.
_SWEEPS, _LEAST_VARIANCE = 8, 1e-6


@dataclass(frozen=True)
class Block:
    """Whitened rows of one joint: X (P_j, m), y (m,), and which coefficients ``own`` (P_j,) its columns are."""

    X: np.ndarray
    y: np.ndarray
    own: np.ndarray


@dataclass(frozen=True)
class Addition:
    """Columns beside a posterior, (*batch) alternatives of them.

    Attributes:
        log_evidence: (*batch) in nats.
        mean, std: (*batch, K) of their coefficients.
    """

    log_evidence: np.ndarray
    mean: np.ndarray
    std: np.ndarray


class Gaussian:
    """The posterior of coefficients z (P,), given one block of whitened rows a joint.

    Args:
        blocks: one a joint.
        n: number of coefficients P.
        first: log prior density of the first of them; the others have N(0, 1).
        sites: precision (P,) and shift (P,) that multiply the prior, see ``nonnegative``.

    Attributes:
        data, score: X'X (P, P) and X'y (P,), without any prior.
        L: (P, P) Cholesky factor of the precision.
        z: (P,) posterior mean.
        left: per joint, whitened residual (m,).
        log_evidence: of the rows, in units of their noise.
    """

    def __init__(
        self,
        blocks: Sequence[Block],
        n: int,
        first: Quadratic | None = None,
        sites: tuple[np.ndarray, np.ndarray] | None = None,
    ) -> None:
        self.blocks = tuple(blocks)
        self.data, self.score = np.zeros((n, n)), np.zeros(n)
        for b in self.blocks:
            self.data[np.ix_(b.own, b.own)] += b.X @ b.X.T
            self.score[b.own] += b.X @ b.y
        H, h = self.data + np.eye(n), self.score.copy()
        self._constant = 0.0
        if first is not None:
            k = len(first.shift)
            H[:k, :k] += first.precision - np.eye(k)
            h[:k] += first.shift
            self._constant = first.constant
        if sites is not None:
            H[np.diag_indices(n)] += sites[0]
            h += sites[1]
        self._solve(H, h)

    def _solve(self, H: np.ndarray, h: np.ndarray) -> None:
        self.H, self.h = H, h
        size = np.sqrt(H.diagonal())
        # Of noise-free torques, rounding would decide the weak directions.
        self.L = size[:, None] * np.linalg.cholesky(H / size / size[:, None] + _ROUNDING * np.eye(len(H)))
        self.z = cho_solve((self.L, True), h, check_finite=False)
        self.left = [b.y - self.z[b.own] @ b.X for b in self.blocks]
        power = sum(float(b.y @ b.y) for b in self.blocks)
        self.log_evidence = self._constant - 0.5 * (power - float(h @ self.z)) - float(np.log(np.diag(self.L)).sum())

    def among(self, kept: np.ndarray) -> Gaussian:
        """Return the posterior of a model that has some of the coefficients alone."""
        number = np.full(len(self.z), -1)
        number[kept] = np.arange(len(kept))
        inside = [number[b.own] >= 0 for b in self.blocks]
        one = copy(self)
        one.blocks = tuple(Block(b.X[k], b.y, number[b.own[k]]) for b, k in zip(self.blocks, inside, strict=True))
        one._solve(self.H[np.ix_(kept, kept)], self.h[kept])
        return one

    def covariance(self, index: Sequence[int] | np.ndarray) -> np.ndarray:
        """Return the posterior covariance of some coefficients, (K, K)."""
        V = solve_triangular(self.L, np.eye(len(self.z))[:, index], lower=True, check_finite=False)
        return V.T @ V

    @lru_cache(maxsize=64)  # noqa: B019  (a posterior lives as long as its fit)
    def used(self, joint: int) -> float:
        """Return the degrees of freedom that the fit takes from a joint's rows."""
        b = self.blocks[joint]
        V = solve_triangular(self.L, np.eye(len(self.z))[:, b.own], lower=True, check_finite=False)
        return float(((V @ b.X) ** 2).sum())

    def beside(self, columns: dict[int, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        """Return precision S (K, K) and score r (K,) of whitened columns, (K, m) by joint."""
        K = len(next(iter(columns.values())))
        cross, S, r = np.zeros((len(self.z), K)), np.zeros((K, K)), np.zeros(K)
        for joint, C in columns.items():
            b = self.blocks[joint]
            cross[b.own] += b.X @ C.T
            S += C @ C.T
            r += C @ self.left[joint]
        V = solve_triangular(self.L, cross, lower=True, check_finite=False)
        return S - V.T @ V, r

    def against_zero(self, index: Sequence[int] | np.ndarray) -> float:
        """Return the log evidence against leaving out some coefficients: Savage and Dickey's density ratio at zero."""
        C, m = self.covariance(index), self.z[list(index)]
        return 0.5 * float(np.linalg.slogdet(C)[1] + m @ np.linalg.solve(C, m))


def added(S: np.ndarray, r: np.ndarray, std: np.ndarray, positive: Sequence[int] = ()) -> Addition:
    """Return the evidence of columns with precision S (*batch, K, K) and score r (*batch, K) beside a posterior.

    Args:
        S, r: what ``Gaussian.beside`` returns.
        std: (*batch, K) prior standard deviations of the coefficients.
        positive: indices of those that cannot be negative.

    Raises:
        LinAlgError: S is no precision.
    """
    A = np.eye(S.shape[-1]) + std[..., :, None] * S * std[..., None, :]
    inverse = np.linalg.inv(A)
    mean = std * (inverse @ (std * r)[..., None])[..., 0]
    spread = std * np.sqrt(np.maximum(np.diagonal(inverse, axis1=-2, axis2=-1), 0.0))
    sign, log_det = np.linalg.slogdet(A)
    if not (sign > 0).all():
        raise np.linalg.LinAlgError("columns beside a posterior have no positive definite precision")
    log_evidence = 0.5 * (mean * r).sum(-1) - 0.5 * log_det
    for k in positive:
        told = spread[..., k] > 0
        ratio = np.divide(mean[..., k], spread[..., k], out=np.zeros_like(spread[..., k]), where=told)
        log_evidence = log_evidence + np.where(told, np.log(2.0) + log_ndtr(ratio), 0.0)
    return Addition(log_evidence, mean, spread)


def nonnegative(mean: np.ndarray, covariance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the Gaussian sites that stand for coefficients (K,) which cannot be negative: precision and shift (K,).

    Each site makes mean and variance of its coefficient those of the truncated density beside the other sites.

    Source: Minka, "Expectation Propagation for Approximate Bayesian Inference", UAI 2001, sec. 3.
    """
    m, C = mean.copy(), covariance.copy()
    precision, shift = np.zeros((2, len(m)))
    for _ in range(_SWEEPS):
        for k in range(len(m)):
            rest = 1.0 / C[k, k] - precision[k]
            if rest <= 0:
                continue
            std, centre = rest**-0.5, (m[k] / C[k, k] - shift[k]) / rest
            ratio = math.exp(_log_normal(centre / std) - float(log_ndtr(centre / std)))
            variance = std**2 * max(1.0 - ratio * (ratio + centre / std), _LEAST_VARIANCE)
            more = max(1.0 / variance - rest, 0.0) - precision[k]
            turn = (centre + std * ratio) / variance - centre * rest - shift[k]
            precision[k] += more
            shift[k] += turn
            column = C[:, k].copy()
            C -= np.outer(column, column) * (more / (1.0 + more * column[k]))
            m += column * ((turn - more * m[k]) / (1.0 + more * column[k]))
    return precision, shift


def _log_normal(x: float) -> float:
    return -0.5 * x * x - 0.5 * math.log(2.0 * math.pi)
