"""Maximum-likelihood factor analysis on second moments, with input noise known or not, of a rank that the data choose.

    C = L L' + diag(D) + Psi

L (d, k): what inputs have in common; D (d,): what an input has of its own; Psi (d, d): noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from scipy.sparse.linalg import eigsh
from torch import Tensor

from torchrbd.regression.classical import nonzero_root
from torchrbd.regression.moments import Moments

LEAST_OWN = 1e-4
_MOST_ITERATIONS, _RANK_FOLDS = 200, 2


@dataclass(frozen=True)
class FactorModel:
    """``loadings`` L (d, k), ``own`` D (d,) and ``noise`` Psi (d, d) of C = L L' + diag(D) + Psi."""

    loadings: Tensor
    own: Tensor
    noise: Tensor

    @property
    def rest(self) -> Tensor:
        """diag(D) + Psi, (d, d)."""
        return torch.diag(self.own) + self.noise

    @property
    def covariance(self) -> Tensor:
        """C, (d, d)."""
        return self.loadings @ self.loadings.T + self.rest

    @property
    def communality(self) -> Tensor:
        """Share of each input's variance that it has in common with others, (d,), 0 to 1."""
        common = self.loadings.square().sum(1)
        return common / (common + self.rest.diagonal()).clamp_min(1e-300)


def fit_factors(C: Tensor, rank: int, noise: Tensor, tolerance: float = 1e-3) -> FactorModel:
    """Fit a factor model of given rank by alternating between L, at its optimum given D, and D.

        R R' = diag(D) + Psi,   R^-1 C R^-T = V diag(l) V',   L = R V_k (l_k - 1)^1/2,   D = diag(C - L L' - Psi)

    D stays at or above 0, and so far above it that the variance that is not common is at least 1e-4 of each input's.

    Args:
        C: (d, d) second moments.
        rank: number of factors k.
        noise: (d, d) Psi, at least part of what is not common; zero where unknown.
        tolerance: on the relative change of diag(D) + Psi at which to stop.

    Source: Lawley, Maxwell, "Factor Analysis as a Statistical Method" (1971), eqs. (4.13) and (4.14).
    """
    scale = nonzero_root(C.diagonal())
    C, noise = C / (scale.unsqueeze(1) * scale), noise / (scale.unsqueeze(1) * scale)
    known = noise.diagonal()
    least = (LEAST_OWN - known).clamp_min(0.0)
    own = torch.maximum(0.5 * C.diagonal() - known, least)
    loadings = C.new_zeros(len(C), 0)
    if rank == 0:
        own = torch.maximum(C.diagonal() - known, least)
    for _ in range(_MOST_ITERATIONS if rank else 0):
        R = torch.linalg.cholesky(torch.diag(own) + noise)
        half = torch.linalg.solve_triangular(R, C, upper=False)
        value, vector = _leading(torch.linalg.solve_triangular(R, half.T, upper=False), rank)
        loadings = R @ vector * (value - 1.0).clamp_min(0.0).sqrt()
        before, own = own, torch.maximum(C.diagonal() - loadings.square().sum(1) - known, least)
        if float(((own - before) / (before + known)).abs().max()) < tolerance:
            break
    return FactorModel(scale.unsqueeze(1) * loadings, scale.square() * own, scale.unsqueeze(1) * noise * scale)


def choose_rank(moments: Moments, noise: Tensor) -> int:
    """Return the number of factors with the greatest likelihood of left-out blocks, two folds.

    Ranks double until the likelihood falls, then the best one between is found by halving steps.

    Args:
        moments: moments of the inputs.
        noise: (d, d) Psi.
    """
    fold = torch.arange(len(moments.count)) % min(_RANK_FOLDS, len(moments.count))
    parts = [(moments.select(fold != f), moments.select(fold == f)) for f in fold.unique()]
    if len(parts) < 2:
        parts = [(moments, moments)]
    seen: dict[int, float] = {}

    def misfit(rank: int) -> float:
        if rank not in seen:
            seen[rank] = sum(_misfit(fit_factors(a.xx, rank, noise, 1e-2).covariance, b.xx) for a, b in parts)
        return seen[rank]

    # With more than (d - 1) / 2 factors the model fits any covariance.
    most, best, step = max(0, (moments.d - 1) // 2), 0, 1
    while best + step <= most and misfit(best + step) < misfit(best):
        best, step = best + step, 2 * step
    while step > 1:
        step //= 2
        best = min((r for r in (best - step, best, best + step) if 0 <= r <= most), key=misfit)
    return best


def _misfit(model: Tensor, C: Tensor) -> float:
    """Return -2 / N times the log likelihood of rows with moments C, less a constant."""
    factor = torch.linalg.cholesky(model)
    return float(2.0 * factor.diagonal().log().sum() + torch.cholesky_solve(C, factor).diagonal().sum())


def _leading(A: Tensor, k: int) -> tuple[Tensor, Tensor]:
    """Return the k largest eigenvalues of A and their vectors."""
    d = len(A)
    if d < 200 or k > d // 10:
        value, vector = torch.linalg.eigh(A)
        return value[-k:], vector[:, -k:]
    # A fixed start keeps the result the same from run to run.
    value, vector = eigsh(A.numpy(), k, which="LA", v0=np.full(d, d**-0.5))
    return torch.as_tensor(value), torch.as_tensor(vector)
