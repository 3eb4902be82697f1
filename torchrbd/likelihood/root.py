"""The root of a precision whose coefficients meet in few others: joints share bodies and clocks, the rest is their own.

Cholesky's factor of all coefficients costs P^3 / 3; what a joint has alone costs its own cube, and what it shares with
others a product (block elimination: Golub and Van Loan, "Matrix Computations", sec. 4.5).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.linalg import solve_triangular

ROUNDING, _LEAST_PRECISION = 1e-13, 1e-280


class Root:
    """A root F of a precision H = F F' (P, P), whose ``local`` groups of coefficients do not meet each other.

        H_jj = L_j L_j',   X_j = L_j^-1 H_js,   H_ss - sum_j X_j'X_j = L_s L_s'

        F = [L_s  X_1' X_2' ...]
            [     L_1          ]
            [          L_2     ]

    Without such groups it is Cholesky's factor.

    Args:
        H: (P, P) precision.
        local: indices of each group; all others are shared.
        rounding: part of its diagonal that is added to H.

    Raises:
        LinAlgError: H is no precision.
    """

    def __init__(self, H: np.ndarray, local: Sequence[np.ndarray] = (), rounding: float = ROUNDING) -> None:
        self.shared = np.setdiff1d(np.arange(len(H)), np.concatenate(local)) if len(local) else np.arange(len(H))
        self.left, self.local = _raised(H, self.shared, rounding), []
        for own in local:
            L = np.linalg.cholesky(_raised(H, own, rounding))
            X = forwards(L, H[np.ix_(own, self.shared)])
            self.left -= X.T @ X
            self.local.append((own, L, X))
        self.L = np.linalg.cholesky(self.left)

    @property
    def log_det(self) -> float:
        """log det F."""
        return float(sum(np.log(L.diagonal()).sum() for L in (self.L, *(L for _, L, _ in self.local))))

    @property
    def matrix(self) -> np.ndarray:
        """F, (P, P)."""
        F = np.zeros((len(self.shared) + sum(len(own) for own, *_ in self.local),) * 2)
        F[np.ix_(self.shared, self.shared)] = self.L
        for own, L, X in self.local:
            F[np.ix_(own, own)], F[np.ix_(self.shared, own)] = L, X.T
        return F

    def half(self, B: np.ndarray) -> np.ndarray:
        """Return F^-1 B of B (P, ...)."""
        found, shared = np.zeros(B.shape), B[self.shared].astype(float)
        for own, L, X in self.local:
            if (part := B[own]).any():
                found[own] = part = forwards(L, part)
                shared -= X.T @ part
        found[self.shared] = forwards(self.L, shared)
        return found

    def solve(self, B: np.ndarray) -> np.ndarray:
        """Return H^-1 B of B (P, ...)."""
        found = self.half(B)
        found[self.shared] = shared = solve_triangular(
            self.L, found[self.shared], lower=True, trans=1, check_finite=False
        )
        for own, L, X in self.local:
            found[own] = solve_triangular(L, found[own] - X @ shared, lower=True, trans=1, check_finite=False)
        return found


def _raised(H: np.ndarray, own: np.ndarray, rounding: float) -> np.ndarray:
    """Return a part of a precision; of noise-free torques, rounding would decide the weak directions."""
    part = H[np.ix_(own, own)]
    at = np.diag_indices_from(part)
    part[at] += rounding * np.maximum(part[at], _LEAST_PRECISION)
    return part


def forwards(L: np.ndarray, B: np.ndarray) -> np.ndarray:
    """Return L^-1 B of a lower triangle L."""
    return solve_triangular(L, B, lower=True, check_finite=False)
