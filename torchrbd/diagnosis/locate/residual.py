"""What a fit leaves, made white: so that chance can be counted, and what the fit has absorbed is not looked for.

Noise of torques is coloured and drifts. Each joint's rows are passed through the filter that whitens its leftover,

    e_j(k) = (r_j(k) - sum_i a_ji r_j(k - i)) / s_j

(autoregressive, by Yule and Walker), the regression is solved on the whitened rows of all joints together, and filter
and fit are repeated until they agree. The leftover of a fit is not noise: it is (1 - Q Q') times it, with Q an
orthonormal basis of the whitened columns. Whatever is looked for in it is projected alike: a feature A at joint j has

    A' e   and   A'A - (Q_j' A)' (Q_j' A)

as its normal equations. Source: Prais-Winsten or Cochrane-Orcutt for many regressions with common parameters.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_toeplitz

from torchrbd.diagnosis.locate.rows import Rows

ORDER, ROUNDS = 4, 4
# A sample of torque is believed to this part of the joint's RMS at best: what is smaller does not matter, and simulated
# torques without noise would make it significant.
LEAST_NOISE = 2e-3
# White floor of the spectrum: what whitening amplifies at most.
_FLOOR = 0.02
# Directions of the scaled columns below this are told by rounding alone.
_LEAST_DIRECTION = 1e-8


Noise = tuple[np.ndarray, np.ndarray]
"""Filters (n, ORDER) and scale (n,) of a ``Leftover``."""


@dataclass(frozen=True)
class Leftover:
    """The whitened leftover of a fit, unit variance.

    Attributes:
        rows: where it comes from.
        index: per joint, the samples that have ``ORDER`` predecessors in their run, (m_j,).
        filters: (n, ORDER) a_ji.
        scale: (n,) s_j, [N m] or [N].
        basis: per joint (m_j, P), its rows of Q.
        e: per joint (m_j,).
        raw: (M, n) leftover as it is, [N m] or [N]; NaN where not measured.
    """

    rows: Rows
    index: tuple[np.ndarray, ...]
    filters: np.ndarray
    scale: np.ndarray
    basis: tuple[np.ndarray, ...]
    e: tuple[np.ndarray, ...]
    raw: np.ndarray

    def white(self, joint: int, A: np.ndarray) -> np.ndarray:
        """Return features (M, ...) at a joint as the leftover sees them, (m_j, ...), not projected."""
        return whitened(A, self.index[joint], self.filters[joint], self.scale[joint])

    def equations(self, A: Mapping[int, np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return what the data says of coefficients of whitened features A (m_j, K) at joints.

        Returns:
            Gram (K, K) beside the fit, the same without it, and score (K,).
        """
        C = np.sum([self.basis[j].T @ A_j for j, A_j in A.items()], axis=0)
        G = np.sum([A_j.T @ A_j for A_j in A.values()], axis=0)
        return G - C.T @ C, G, np.sum([A_j.T @ self.e[j] for j, A_j in A.items()], axis=0)

    @property
    def noise(self) -> Noise:
        """What makes it white."""
        return self.filters, self.scale

    @property
    def raw_std(self) -> np.ndarray:
        """Standard deviation of the raw leftover, (n,); NaN for a joint without torque."""
        count = np.isfinite(self.raw).sum(0)
        centred = self.raw - np.nansum(self.raw, 0) / np.maximum(count, 1)
        return np.where(count > 0, np.sqrt(np.nansum(centred**2, 0) / np.maximum(count, 1)), np.nan)

    @property
    def log_likelihood(self) -> float:
        """Of the best fit, up to a constant: - sum_j m_j / 2 log(RSS_j / m_j)."""
        total, least = 0.0, LEAST_NOISE**2 * np.mean(self.rows.tau**2, axis=0)
        for j, e in enumerate(self.e):
            if len(e):
                variance = self.scale[j] ** 2 * float(np.mean(e**2)) + least[j]
                total -= 0.5 * len(e) * float(np.log(max(variance, 1e-300)))
        return total


def fit_rows(
    rows: Rows,
    added: Mapping[int, np.ndarray] | None = None,
    shared: Sequence[np.ndarray] = (),
    noise: Noise | None = None,
    rounds: int = ROUNDS,
) -> Leftover:
    """Fit rigid body, friction and what was located before; return what is left.

    Args:
        rows: the data.
        added: further columns (M, K) by joint.
        shared: further columns (n, M, K) whose coefficients all joints share.
        noise: what makes the leftover white, to start with.
        rounds: of estimating it.
    """
    n = rows.tau.shape[1]
    own = [np.concatenate((rows.own[j], *([added[j]] if added and j in added else [])), axis=1) for j in range(n)]
    columns = _Columns(rows, own, np.concatenate((rows.rigid, rows.shared, *shared), axis=2))
    rms = np.sqrt(np.mean(rows.tau**2, axis=0))
    filters, scale = noise or (np.zeros((n, ORDER)), np.where(rms > 0, 0.1 * rms, 1.0))
    for _ in range(rounds):
        _, basis, raw = columns.solve(filters, scale)
        filters, scale = np.zeros_like(filters), scale.copy()
        for j, index in enumerate(columns.index):
            if len(index):
                filters[j] = predictor(raw[:, j], index)
                e = whitened(raw[:, j], index, filters[j], 1.0)
                left = max(len(e) - float(np.sum(basis[j] ** 2)), 0.1 * len(e))
                scale[j] = max(float(np.sqrt(np.sum(e**2) / left + (LEAST_NOISE * rms[j]) ** 2)), 1e-300)
    e, basis, raw = columns.solve(filters, scale)
    return Leftover(rows, columns.index, filters, scale, basis, e, np.where(rows.measured, raw, np.nan))


class _Columns:
    """The regression of all joints together: each joint's own columns, and common ones."""

    def __init__(self, rows: Rows, own: Sequence[np.ndarray], common: np.ndarray) -> None:
        self.rows, self.own, self.common = rows, own, common
        self.index = tuple(_with_predecessors(rows, j) for j in range(len(own)))
        self.sizes = [o.shape[1] for o in own]

    def solve(
        self, filters: np.ndarray, scale: np.ndarray
    ) -> tuple[tuple[np.ndarray, ...], tuple[np.ndarray, ...], np.ndarray]:
        """Return per joint the whitened leftover and the basis, and the raw leftover (M, n)."""
        tau, n_common = self.rows.tau, self.common.shape[2]
        first = n_common + np.cumsum([0, *self.sizes])
        ends = np.cumsum([0, *(len(i) for i in self.index)])
        D, y = np.zeros((ends[-1], first[-1])), np.zeros(ends[-1])
        for j, index in enumerate(self.index):
            part, noise = slice(ends[j], ends[j + 1]), (index, filters[j], scale[j])
            D[part, :n_common] = whitened(self.common[j], *noise)
            D[part, first[j] : first[j + 1]] = whitened(self.own[j], *noise)
            y[part] = whitened(tau[:, j], *noise)
        x, Q = _solved(D, y)
        predicted = [self.common[j] @ x[:n_common] + own @ x[first[j] : first[j + 1]] for j, own in enumerate(self.own)]
        e = y - Q @ (Q.T @ y)
        return (
            tuple(np.split(e, ends[1:-1])),
            tuple(np.split(Q, ends[1:-1])),
            tau - np.stack(predicted, axis=1),
        )


def _with_predecessors(rows: Rows, joint: int) -> np.ndarray:
    k = np.arange(ORDER, len(rows.t))
    same = rows.run[k] == rows.run[k - ORDER]
    return k[same & rows.measured[k, joint] & rows.measured[k - ORDER, joint]]


def whitened(A: np.ndarray, index: np.ndarray, a: np.ndarray, scale: float) -> np.ndarray:
    """Return a signal (M, ...) less what its predecessors predict, at some samples, over a scale."""
    out = A[index].astype(float)
    for i, a_i in enumerate(a, start=1):
        out = out - a_i * A[index - i]
    return out / scale


def predictor(r: np.ndarray, index: np.ndarray) -> np.ndarray:
    """Return the predictor (ORDER,) of a leftover from its predecessors."""
    c = np.array([np.mean(r[index] * r[index - i]) for i in range(ORDER + 1)])
    c[0] = (1 + _FLOOR) * max(c[0], np.mean(r[index - ORDER] ** 2), 1e-300)
    return solve_toeplitz(c[:-1], c[1:])


def _solved(D: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return least-squares coefficients and an orthonormal basis of the columns."""
    size = np.linalg.norm(D, axis=0)
    size = np.where(size > 0, size, 1.0)
    values, vectors = np.linalg.eigh((D / size).T @ (D / size))
    kept = values > _LEAST_DIRECTION * values[-1]
    T = vectors[:, kept] / np.sqrt(values[kept]) / size[:, None]
    Q = D @ T
    return T @ (Q.T @ y), Q
