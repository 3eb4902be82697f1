"""Normal equations of block statistics, and the noise that gives each joint its weight in them.

In prior coordinates x = x0 + S z the prior is N(0, 1), so H_z = S'HS + 1 is well scaled:

    z = H_z^-1 S'(h - H x0),   H = sum_j A_j / sigma_j^2

Only the *free* columns are fitted; the others keep their reference value.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import torch
from torch import Tensor

from torchrbd.dataset.block_statistics import BlockStatistics, assemble
from torchrbd.dataset.columns import Columns
from torchrbd.likelihood.gaussian import Posterior
from torchrbd.likelihood.urdf_prior import Prior

# Least noise as a fraction of the torque's RMS: noise-free simulations would have infinite weights.
LEAST_NOISE = 1e-5
_LEAST_FREEDOM = 0.02
# Rounds of re-weighting of a linear fit: about three give three digits.
_ROUNDS = 4

F = TypeVar("F")


@dataclass(frozen=True)
class Equations:
    """Normal equations in prior coordinates, over all columns and without the prior: H (n, n), h (n,)."""

    H: Tensor
    h: Tensor

    def posterior(self, free: Tensor | slice = slice(None)) -> Posterior:
        """Return the posterior of the coefficients z of some columns, with the others at zero."""
        H = self.H[free][:, free].numpy()
        return Posterior(H + np.eye(len(H)), self.h[free].numpy())


def scaled_equations(prior: Prior, totals: Sequence[Tensor], columns: Columns, weights: Tensor) -> Equations:
    """Return S'HS and S'(h - H x0) for summed moments."""
    H, h = assemble(columns, totals, weights)
    h = prior.scaled((h - H @ prior.mean).unsqueeze(1), back=True)[:, 0]
    return Equations(prior.scaled(prior.scaled(H, back=True).T, back=True), h)


def linear_fit(statistics: BlockStatistics, prior: Prior, free: Tensor) -> tuple[Tensor, Tensor]:
    """Fit some columns, the others at their reference; joints are weighted by their residual noise.

    Terms at a nonzero reference (friction in the URDF) are part of x0 whether they are free or not.

    Args:
        statistics: blocks to fit.
        prior: the prior.
        free: indices of the fitted columns.

    Returns:
        Posterior mean x (n,) and noise variance (n_dof,) [(N m)^2] or [N^2]; inf for a joint without torque.
    """
    totals, S = statistics.total(), prior.scale[:, free]

    def fit(variance: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        found = scaled_equations(prior, totals, statistics.columns, 1.0 / variance).posterior(free)
        x, half = prior.mean + S @ torch.from_numpy(found.z), torch.from_numpy(found.half(S.T.numpy()))
        return x, x, half.T @ half

    return with_noise(statistics, fit, rounds=_ROUNDS)


def with_noise(
    statistics: BlockStatistics,
    fit: Callable[[Tensor], tuple[F, Tensor, Tensor]],
    variance: Tensor | None = None,
    *,
    rounds: int,
    tolerance: float = 0.0,
    states: Tensor | None = None,
) -> tuple[F, Tensor]:
    """Alternate between a fit and an estimate of each joint's noise from its residual.

    Args:
        statistics: the blocks that are fitted.
        fit: from noise variances (n_dof,) to a fit, its x (n,) and their covariance (n, n).
        variance: (n_dof,) initial value; a hundredth of the torque's mean square if not given.
        rounds: largest number of rounds.
        settled: change of the logarithm below which the noise has converged.
        states: see ``residual_variance``.

    Returns:
        The fit, and the noise (n_dof,) that it assumes.
    """
    variance = first_noise_variance(statistics) if variance is None else variance
    for _ in range(rounds):
        found, x, covariance = fit(variance)
        left = residual_variance(statistics, x, covariance, variance, states)
        if bool(((left / variance).log()[torch.isfinite(left)].abs() < tolerance).all()):
            return found, variance
        variance = left
    return fit(variance)[0], variance


def first_noise_variance(statistics: BlockStatistics) -> Tensor:
    """Return the initial noise variance (n_dof,), for a tenth of the torque; inf for a joint without torque."""
    return bounded(statistics, 0.1**2 * statistics.torque[..., 2].sum(0) / _count(statistics))


def residual_variance(
    statistics: BlockStatistics, x: Tensor, covariance: Tensor, variance: Tensor, states: Tensor | None = None
) -> Tensor:
    """Return the noise variance from a fit's residual.

        sigma_j^2 = RSS_j / ((1 - s_j) n_j - gamma_j),   gamma_j = tr(cov(x) A_j) / sigma_j^2

    gamma_j is the number of parameters that the joint's data determine, and s_j the share of the samples that estimated
    states take.

    Args:
        statistics: the blocks fitted.
        x: (n,) fitted coefficients.
        covariance: (n, n) of x.
        variance: (n_dof,) noise that the fit assumed.
        states: s (n_dof,), if states were estimated.
    """
    used = torch.stack(
        [
            (covariance[own.unsqueeze(1), own] * total[:-1, :-1]).sum() / v
            for own, total, v in zip(statistics.columns.of_joint, statistics.total(), variance, strict=True)
        ]
    )
    count = _count(statistics)
    left = count if states is None else count * (1.0 - states).clamp_min(_LEAST_FREEDOM)
    return bounded(statistics, statistics.squared_error(x).sum(0) / (left - used).clamp_min(0.1 * left))


def _count(statistics: BlockStatistics) -> Tensor:
    return statistics.torque[..., 0].sum(0).clamp_min(1e-300)


def bounded(statistics: BlockStatistics, variance: Tensor) -> Tensor:
    """Return noise (n_dof,) kept above rounding; a joint without torque has infinite noise."""
    count = _count(statistics)
    least = (LEAST_NOISE**2 * statistics.torque[..., 2].sum(0) / count).clamp_min(1e-300)
    return torch.where(count > 1e-300, torch.maximum(variance, least), torch.inf)
