"""The root of a precision in which most coefficients belong to one joint; joints share only bodies and clocks.

Cholesky's factor of all coefficients costs P^3 / 3. Block elimination costs the cube of each joint's own coefficients,
and one product with the shared ones (Golub and Van Loan, "Matrix Computations", sec. 4.5).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.linalg import get_lapack_funcs

ROUNDING, _LEAST_PRECISION = 1e-13, 1e-280
# Called directly: scipy's solve_triangular takes longer to check its arguments.
(_trtrs,) = get_lapack_funcs(("trtrs",), dtype=np.float64)


class Local(NamedTuple):
    """Coefficients ``own`` (k,) of one group, L_j (k, k), and X_j (k, m) for the shared ones (m,) with products."""

    own: np.ndarray
    L: np.ndarray
    X: np.ndarray
    met: np.ndarray


class Eliminated(NamedTuple):
    """Some coefficients that are eliminated: L_j (k, k), X_j (k, m), X_j'X_j (m, m), and ``met`` (m,), see ``Root``."""

    L: np.ndarray
    X: np.ndarray
    lost: np.ndarray
    met: np.ndarray


def eliminate(own: np.ndarray, across: np.ndarray, prior: np.ndarray) -> Eliminated:
    """Eliminate coefficients with precision ``own`` (k, k) + prior (k,) and products ``across`` (k, s) with others.

    Raises:
        LinAlgError: the precision is not positive definite.
    """
    L = np.linalg.cholesky(_raised(own, prior, ROUNDING))
    met = np.flatnonzero(across.any(axis=0))
    X = forwards(L, across[:, met])
    return Eliminated(L, X, X.T @ X, met)


class Root:
    """A root F of a precision H = F F' (P, P), with no products between its ``local`` groups of coefficients.

        H_jj = L_j L_j',   X_j = L_j^-1 H_js,   H_ss - sum_j X_j'X_j = L_s L_s'

        F = [L_s  X_1' X_2' ...]
            [     L_1          ]
            [          L_2     ]

    X_j is stored where it is not zero: a joint shares the bodies that it moves. Without groups F is Cholesky's factor.

    Args:
        shared: indices of the coefficients in no group.
        H: (S, S) their precision.
        local: indices of each group, and what eliminates it. A group's ``met`` count among the shared ones.
        rounding: fraction of its diagonal that is added to H.

    Raises:
        LinAlgError: H is not positive definite.
    """

    def __init__(
        self,
        shared: np.ndarray,
        H: np.ndarray,
        local: Sequence[tuple[np.ndarray, Eliminated]] = (),
        rounding: float = ROUNDING,
    ) -> None:
        self.shared, self.left = shared, _raised(H, 0.0, rounding)
        self.local = [Local(own, one.L, one.X, one.met) for own, one in local]
        for _, one in local:
            self.left[np.ix_(one.met, one.met)] -= one.lost
        self.L = np.linalg.cholesky(self.left)

    @property
    def log_det(self) -> float:
        """log det F."""
        return float(sum(np.log(L.diagonal()).sum() for L in (self.L, *(one.L for one in self.local))))

    @property
    def matrix(self) -> np.ndarray:
        """F, (P, P)."""
        F = np.zeros((len(self.shared) + sum(len(one.own) for one in self.local),) * 2)
        F[np.ix_(self.shared, self.shared)] = self.L
        for own, L, X, met in self.local:
            F[np.ix_(own, own)], F[np.ix_(self.shared[met], own)] = L, X.T
        return F

    def half(self, B: np.ndarray) -> np.ndarray:
        """Return F^-1 B for B (P, ...)."""
        found, shared = np.zeros(B.shape), B[self.shared].astype(float)
        for own, L, X, met in self.local:
            if (part := B[own]).any():
                found[own] = part = forwards(L, part)
                shared[met] -= X.T @ part
        found[self.shared] = forwards(self.L, shared)
        return found

    def group_and_shared(self, group: int) -> np.ndarray:
        """Return the indices of one group and of the shared ones: if B is zero elsewhere, F^-1 B is too."""
        return np.concatenate((self.shared, self.local[group].own))

    def solve(self, B: np.ndarray) -> np.ndarray:
        """Return H^-1 B for B (P, ...)."""
        found = self.half(B)
        found[self.shared] = shared = _backwards(self.L, found[self.shared])
        for own, L, X, met in self.local:
            found[own] = _backwards(L, found[own] - X @ shared[met])
        return found

    def covariance(self, index: np.ndarray) -> np.ndarray:
        """Return the rows and columns (K, K) of H^-1 for some coefficients."""
        place = np.full(len(self.shared) + sum(len(one.own) for one in self.local), -1)
        place[index] = np.arange(len(index))
        shared = np.zeros((len(self.shared), len(index)))
        at = place[self.shared]
        shared[at >= 0, at[at >= 0]] = 1.0
        found = np.zeros((len(index),) * 2)
        for own, L, X, met in self.local:
            here = np.flatnonzero(place[own] >= 0)
            if len(here):
                units = np.zeros((len(own), len(here)))
                units[here, np.arange(len(here))] = 1.0
                V, columns = forwards(L, units), place[own[here]]
                shared[np.ix_(met, columns)] -= X.T @ V
                found[np.ix_(columns, columns)] = V.T @ V
        V = forwards(self.L, shared)
        return found + V.T @ V


def _raised(H: np.ndarray, prior: np.ndarray | float, rounding: float) -> np.ndarray:
    """Return a precision with a raised diagonal: without noise, rounding would dominate weak directions."""
    part, at = H.copy(), np.diag_indices_from(H)
    part[at] += prior
    part[at] += rounding * np.maximum(part[at], _LEAST_PRECISION)
    return part


def forwards(L: np.ndarray, B: np.ndarray) -> np.ndarray:
    """Return L^-1 B for a lower triangle L."""
    return _trtrs(L.T, B, lower=0, trans=1)[0] if B.size else np.zeros(B.shape)


def _backwards(L: np.ndarray, B: np.ndarray) -> np.ndarray:
    """Return L'^-1 B for a lower triangle L."""
    return _trtrs(L.T, B, lower=0, trans=0)[0] if B.size else np.zeros(B.shape)
