"""What is believed of a body before the data, in log-Cholesky coordinates theta.

    p(theta) ~ exp(-kappa D),   D(J | J_0) = tr(J_0^-1 J) - log det(J_0^-1 J) - 4
    log det J = 8 alpha + 2 (d1 + d2 + d3)

Its mode is the body of the URDF, as that of the convex fit's prior.

Source: Lee, Wensing, Park, "Geometric Robot Dynamic Identification: A Convex Programming Approach", IEEE T-RO 2020,
    eq. (25), (31).
"""

from __future__ import annotations

import torch
from torch import Tensor

from torchrbd.likelihood.urdf_prior import divergence_hessian
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


def spread_divergence(theta: Tensor, root: Tensor) -> Tensor:
    """Return what D grows by, to second order, where pi has the covariance root root', root (10, K), around pi(theta).

    tr(D'' root root') / 2,   D''_kl = tr(J^-1 E_k J^-1 E_l)
    """
    inverse = torch.linalg.inv(pseudo_inertia(from_log_cholesky(theta)))
    return 0.5 * (divergence_hessian(inverse) @ root * root).sum()
