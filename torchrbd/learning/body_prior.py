"""What is believed of a body before the data, in log-Cholesky coordinates theta.

    p(theta) ~ exp(-kappa D),   D(J | J_0) = tr(J_0^-1 J) - log det(J_0^-1 J) - 4
    log det J = 8 alpha + 2 (d1 + d2 + d3)

Its mode is the body of the URDF, as that of the convex fit's prior.

Source: Lee, Wensing, Park, "Geometric Robot Dynamic Identification: A Convex Programming Approach", IEEE T-RO 2020,
    eq. (25); Arasaratnam, Haykin, "Cubature Kalman Filters", IEEE TAC 2009, eq. (23), (24), for expectations.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from torchrbd.parameters import from_log_cholesky
from torchrbd.robot import pseudo_inertia


def divergence(theta: Tensor, start: Tensor) -> Tensor:
    """Return D of two bodies, theta (10,) from start (10,)."""
    inverse = torch.linalg.inv(pseudo_inertia(from_log_cholesky(start)))
    trace = (inverse * pseudo_inertia(from_log_cholesky(theta))).sum()
    change = theta[:4] - start[:4]
    return trace - 8.0 * change[0] - 2.0 * change[1:].sum() - 4.0


def curvature(start: Tensor) -> Tensor:
    """Return the Hessian of D (10, 10) at the body itself, positive definite."""
    hessian = torch.func.jacrev(torch.func.jacrev(divergence))(start, start)
    return 0.5 * (hessian + hessian.T)


def expected_divergence(theta: Tensor, root: Tensor, start: Tensor) -> Tensor:
    """Return the mean of D over coordinates of mean theta (10,) and covariance root root', root (10, K).

    By points of degree three, at sqrt(10) standard deviations to both sides: exact for cubic functions.
    """
    covariance, n = root @ root.T, len(theta)
    jitter = 1e-12 * covariance.diagonal().amax()
    axes = torch.linalg.cholesky(covariance + jitter * torch.eye(n, dtype=theta.dtype, device=theta.device))
    steps = math.sqrt(n) * torch.cat((axes.T, -axes.T))
    return torch.vmap(lambda step: divergence(theta + step, start))(steps).mean()
