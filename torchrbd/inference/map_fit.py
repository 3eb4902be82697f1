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

from torchrbd.inference.block_statistics import BlockStatistics, assemble
from torchrbd.inference.columns import Columns
from torchrbd.inference.prior import Prior

# Torque is believed to this part of its RMS at best: noise-free simulations would have infinite weights.
LEAST_NOISE = 1e-5


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

        sigma_j^2 = RSS_j / (n_j - gamma_j),   gamma_j = tr(H_z^-1 S'A_jS) / sigma_j^2

    Args:
        statistics: blocks to fit.
        prior: the prior.
        free: indices of the fitted columns.
        rounds: of re-weighting; three digits settle in about three.

    Returns:
        (n_dof,) [(N m)^2] or [N^2]; inf for a joint without torque.
    """
    totals = statistics.total()
    count = statistics.torque[..., 0].sum(0)
    power = statistics.torque[..., 2].sum(0) / count.clamp_min(1e-300)
    variance = (0.1**2) * power
    for _ in range(rounds):
        variance = torch.where(count > 0, variance.clamp_min(LEAST_NOISE**2 * power.clamp_min(1e-300)), torch.inf)
        equations = scaled_equations(prior, totals, statistics.columns, 1.0 / variance)
        x = solve(prior, equations, free)
        used = effective_parameters(statistics, prior, free, equations, variance)
        rss = statistics.squared_error(x).sum(0)
        variance = rss / (count - used).clamp_min(0.1 * count).clamp_min(1e-300)
    return torch.where(count > 0, variance.clamp_min(LEAST_NOISE**2 * power.clamp_min(1e-300)), torch.inf)


def effective_parameters(
    statistics: BlockStatistics, prior: Prior, free: Tensor, equations: Scaled, variance: Tensor
) -> Tensor:
    """Return gamma_j (n_dof,): how many parameters each joint's data has used up."""
    H = equations.H[free.unsqueeze(1), free] + torch.eye(len(free), dtype=torch.float64)
    covariance = torch.linalg.inv(H)
    S = prior.scale[:, free]
    x_covariance = S @ covariance @ S.T
    gamma = [
        (x_covariance[own.unsqueeze(1), own] * total[:-1, :-1]).sum() / v
        for own, total, v in zip(statistics.columns.of_joint, statistics.total(), variance, strict=True)
    ]
    return torch.stack(gamma)
