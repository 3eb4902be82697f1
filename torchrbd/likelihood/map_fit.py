"""Linear Gaussian fits on block statistics: the posterior mean and precision of x, with one noise level a joint.

In prior coordinates x = x0 + S z the prior is N(0, 1), so that H_z = S'HS + 1 is well scaled:

    z = H_z^-1 S'(h - H x0),   H = sum_j A_j / sigma_j^2

Only the *free* columns move; the others keep their reference value.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from torchrbd.likelihood.block_statistics import BlockStatistics, assemble
from torchrbd.likelihood.columns import Columns
from torchrbd.likelihood.urdf_prior import Prior

# Torque is believed to this part of its RMS at best: noise-free simulations would have infinite weights.
LEAST_NOISE = 1e-5
_LEAST_FREEDOM = 0.02


@dataclass(frozen=True)
class Scaled:
    """Normal equations in prior coordinates, over all columns: H (n, n), h (n,)."""

    H: Tensor
    h: Tensor


def scaled_equations(prior: Prior, totals: Sequence[Tensor], columns: Columns, weights: Tensor) -> Scaled:
    """Return S'HS and S'(h - H x0) of summed moments."""
    H, h = assemble(columns, totals, weights)
    return Scaled(prior.scale.T @ H @ prior.scale, prior.scale.T @ (h - H @ prior.mean))


def solve(prior: Prior, equations: Scaled, free: Tensor) -> Tensor:
    """Return the posterior mean x (n,) with the columns ``free`` (indices) fitted and the others at their reference.

    Terms at a nonzero reference (friction that the URDF has) are part of x0 whether they are free or not.
    """
    H = equations.H[free.unsqueeze(1), free]
    H = H + torch.eye(len(free), dtype=H.dtype)
    z = torch.cholesky_solve(equations.h[free].unsqueeze(1), torch.linalg.cholesky(H)).squeeze(1)
    return prior.mean + prior.scale[:, free] @ z


def noise_variance(statistics: BlockStatistics, prior: Prior, free: Tensor, *, rounds: int = 4) -> Tensor:
    """Estimate each joint's torque noise by iterated weighted least squares.

    Args:
        statistics: blocks to fit.
        prior: the prior.
        free: indices of the fitted columns.
        rounds: of re-weighting; three digits settle in about three.

    Returns:
        (n_dof,) [(N m)^2] or [N^2]; inf for a joint without torque.
    """
    totals = statistics.total()
    S = prior.scale[:, free]
    variance = first_noise_variance(statistics)
    for _ in range(rounds):
        equations = scaled_equations(prior, totals, statistics.columns, 1.0 / variance)
        H = equations.H[free.unsqueeze(1), free] + torch.eye(len(free), dtype=torch.float64)
        covariance = S @ torch.linalg.inv(H) @ S.T
        variance = residual_variance(statistics, solve(prior, equations, free), covariance, variance)
    return variance


def first_noise_variance(statistics: BlockStatistics) -> Tensor:
    """Return the noise to start from, a tenth of the torque: (n_dof,), inf for a joint without torque."""
    return _bounded(statistics, 0.1**2 * statistics.torque[..., 2].sum(0) / _count(statistics))


def residual_variance(
    statistics: BlockStatistics, x: Tensor, covariance: Tensor, variance: Tensor, states: Tensor | None = None
) -> Tensor:
    """Return the noise that a fit leaves.

        sigma_j^2 = RSS_j / ((1 - s_j) n_j - gamma_j),   gamma_j = tr(cov(x) A_j) / sigma_j^2

    with gamma_j the number of parameters that the joint's data has used up, and s_j the share that states have.

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
    return _bounded(statistics, statistics.squared_error(x).sum(0) / (left - used).clamp_min(0.1 * left))


def _count(statistics: BlockStatistics) -> Tensor:
    return statistics.torque[..., 0].sum(0).clamp_min(1e-300)


def _bounded(statistics: BlockStatistics, variance: Tensor) -> Tensor:
    """Keep noise above rounding; a joint without torque has infinite noise."""
    count = _count(statistics)
    least = (LEAST_NOISE**2 * statistics.torque[..., 2].sum(0) / count).clamp_min(1e-300)
    return torch.where(count > 1e-300, torch.maximum(variance, least), torch.inf)
