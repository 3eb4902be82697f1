"""An interior-point method for the physically valid fit: a quadratic loss with the entropic prior as its barrier.

    minimise  1/2 z'Az - h'z + kappa sum_bodies [tr G - logdet G],  G = 1 + sum_k z_k B_k / sqrt(kappa)

Every matrix G has a dual matrix Z, and at the solution G Z = kappa 1. The Newton steps are taken in the coordinates R
in which both are the same diagonal matrix, G = R s R', Z = R^-T s R^-1 (Nesterov and Todd's scaling). There the
barrier's curvature is 1 everywhere on the path, so steps remain long near the boundary. The factors of G and Z are
updated by products, so no nearly singular matrix is ever factorised.

Source: Todd, Toh, Tutuncu, "On the Nesterov-Todd direction in semidefinite programming", SIAM J. Optimization 1998;
Mehrotra, SIAM J. Optimization 1992 (the choice of mu, without the corrector).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_solve

from torchrbd.parameters import ORTHONORMAL, PARAMETERS_PER_BODY

_MOST_STEPS, _INTERIOR, _SHORT, _EXACT, _NO_PROGRESS = 100, 0.9, 1e-2, 1e-12, 0.25
_SIZE = 4
_B = ORTHONORMAL.flatten(1).numpy()


@dataclass(frozen=True)
class Problem:
    """The objective: A (n, n), h (n,), kappa; bodies are first in z (n,), the prior of other terms is part of A."""

    A: np.ndarray
    h: np.ndarray
    kappa: float
    n_bodies: int

    @property
    def n_inertial(self) -> int:
        """Number of coefficients of bodies."""
        return PARAMETERS_PER_BODY * self.n_bodies

    def columns(self, R: np.ndarray) -> np.ndarray:
        """Return the blocks K (n_bodies, 10, 10) of P = diag(K, 1) with dz = P y for dG = R (sum_k y_k B_k) R'."""
        both = (R[:, :, None, :, None] * R[:, None, :, None, :]).reshape(-1, _SIZE**2, _SIZE**2)
        return self.kappa**0.5 * _B @ both @ _B.T

    def step(
        self, K: np.ndarray, R: np.ndarray, z: np.ndarray, inverse: np.ndarray, mu: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the Newton matrix N, for each mu (k,) the negative gradient (n, k), and the step y (n, k).

        The gradient is that of the objective with the barrier -mu logdet G; ``inverse`` = R' G^-1 R (n_bodies, 4, 4).
        """
        back, own = K.swapaxes(1, 2), slice(self.n_inertial)
        down = -in_blocks(back, (self.A @ z - self.h)[:, None])
        down[own, 0] -= self.kappa * _along(R.swapaxes(1, 2) @ R)
        down = np.repeat(down, len(mu), axis=1)
        down[own] += _along(inverse)[:, None] * mu
        N = in_blocks(back, in_blocks(back, self.A).T)
        N = 0.5 * (N + N.T)
        N[np.diag_indices(self.n_inertial)] += 1.0
        return N, down, _solved(N, down)

    def symmetric(self, y: np.ndarray) -> np.ndarray:
        """Return sum_k y_k B_k (n_bodies, 4, 4)."""
        return (y[: self.n_inertial].reshape(-1, PARAMETERS_PER_BODY) @ _B).reshape(-1, _SIZE, _SIZE)


def follow_path(problem: Problem) -> tuple[np.ndarray, np.ndarray, int, bool]:
    """Return z, the factor L of G = L L', the number of steps, and whether the last one was short."""
    kappa, z = problem.kappa, np.zeros_like(problem.h)
    L = np.tile(np.eye(_SIZE), (problem.n_bodies, 1, 1))
    M = max(kappa, kappa**0.5 * float(np.abs(problem.h).max()) if len(z) else 0.0) ** 0.5 * L
    before = math.inf
    for steps in range(1, _MOST_STEPS + 1):
        U, s, Vh = np.linalg.svd(M.swapaxes(1, 2) @ L)
        root = np.sqrt(s)[:, None]
        R, dual = L @ Vh.swapaxes(1, 2) / root, M @ U / root
        K, diagonal = problem.columns(R), s[:, :, None] * np.eye(_SIZE)
        # Aim at mu = 0 first: the length of that step gives the next mu.
        _, down, y = problem.step(K, R, z, np.eye(_SIZE) / s[:, :, None], np.array([0.0, 1.0]))
        dX = problem.symmetric(y[:, 0])
        reach = min(1.0, _room(s, dX, -diagonal - dX))
        mu = max(kappa, (1.0 - reach) ** 3 * float(np.square(s).mean())) if len(s) else kappa
        y, down = y[:, 0] + mu * (y[:, 1] - y[:, 0]), down[:, 0] + mu * (down[:, 1] - down[:, 0])
        dX = problem.symmetric(y)
        dZ = (mu / s - s)[:, :, None] * np.eye(_SIZE) - dX
        length = min(1.0, _INTERIOR * _room(s, dX, dZ))
        decrement = float(down @ y) / kappa
        if not math.isfinite(decrement) or not length > 0.0:
            return z, L, steps, False
        if mu == kappa and length == 1.0 and (decrement < _EXACT or _NO_PROGRESS * before < decrement < _SHORT):
            return z, L, steps, True
        before = decrement
        z = z + length * in_blocks(K, y[:, None])[:, 0]
        L, M = R @ np.linalg.cholesky(diagonal + length * dX), dual @ np.linalg.cholesky(diagonal + length * dZ)
    return z, L, _MOST_STEPS, False


def in_blocks(K: np.ndarray, X: np.ndarray) -> np.ndarray:
    """Return diag(K, 1) X for blocks K (n_bodies, 10, 10) and X (n, k)."""
    found, k = X.copy(), K.shape[0] * K.shape[1]
    found[:k] = (K @ X[:k].reshape(*K.shape[:2], X.shape[1])).reshape(k, X.shape[1])
    return found


def _along(X: np.ndarray) -> np.ndarray:
    """Return tr(X B_k) for symmetric matrices (n_bodies, 4, 4), (10 n_bodies,)."""
    return (X.reshape(-1, _SIZE**2) @ _B.T).ravel()


def _room(s: np.ndarray, *steps: np.ndarray) -> float:
    """Return the largest multiple of each step (n_bodies, 4, 4) with diag(s) + step >= 0; NaN if not finite."""
    w, both = 1.0 / np.sqrt(s), np.stack(steps)
    if not np.isfinite(both).all():
        return math.nan
    least = np.linalg.eigvalsh(w[:, :, None] * both * w[:, None, :])[..., 0].min(initial=0.0)
    return -1.0 / float(least) if least < 0 else math.inf


def _solved(N: np.ndarray, B: np.ndarray) -> np.ndarray:
    """Return N^-1 B for B (n, k), with the least increase of N's diagonal that rounding needs; NaN if it is large."""
    if not (N.diagonal() > 0.0).all():
        return np.full_like(B, math.nan)
    jitter, d = 0.0, np.sqrt(N.diagonal())[:, None]
    N = N / d / d.T
    while jitter <= 1.0:
        try:
            return cho_solve((np.linalg.cholesky(N + jitter * np.eye(len(N))), True), B / d, check_finite=False) / d
        except np.linalg.LinAlgError:
            jitter = max(10.0 * jitter, 1e-15)
    return np.full_like(B, math.nan)
