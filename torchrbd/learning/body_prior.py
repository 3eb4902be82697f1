"""The prior of bodies, by their log-Cholesky coordinates theta.

    p(theta) ~ exp(-kappa D),   D(J | J_0) = tr(J_0^-1 J) - log det(J_0^-1 J) - 4
    log det J = 8 alpha + 2 (d1 + d2 + d3)

Its mode is the body of the URDF, as for the prior of the convex fit.

Source: Lee, Wensing, Park, "Geometric Robot Dynamic Identification: A Convex Programming Approach", IEEE T-RO 2020,
    eq. (25), (31).
"""

from __future__ import annotations

import torch
from torch import Tensor

from torchrbd.likelihood.urdf_prior import Prior, divergence_hessian, inverse_root
from torchrbd.parameters import PARAMETERS_PER_BODY, from_log_cholesky
from torchrbd.robot import pseudo_inertia


def divergence(theta: Tensor, start: Tensor) -> Tensor:
    """Return D (n_bodies,) of bodies theta (n_bodies, 10) from others."""
    inverse = torch.linalg.inv(pseudo_inertia(from_log_cholesky(start)))
    trace = (inverse * pseudo_inertia(from_log_cholesky(theta))).sum((-2, -1))
    change = theta - start
    return trace - 8.0 * change[:, 0] - 2.0 * change[:, 1:4].sum(-1) - 4.0


def curvature(theta: Tensor) -> Tensor:
    """Return the Hessians of D by inertial parameters, tr(J^-1 E_k J^-1 E_l): (n_bodies, 10, 10)."""
    return divergence_hessian(torch.linalg.inv(pseudo_inertia(from_log_cholesky(theta))))


def as_prior(mean: Tensor, free: Tensor, precision: Tensor, n_bodies: int, kappa: float) -> Prior:
    """Return the prior as fits have it.

    Args:
        mean: (n,) of inertial parameters and coefficients x.
        free: (n_free,) entries that are not known: those of the bodies first.
        precision: (n_free, n_free) of these at the mean.
        n_bodies: how many are free.
        kappa: weight of the divergence.
    """
    scale = torch.zeros(len(mean), len(mean), dtype=mean.dtype)
    scale[free.unsqueeze(1), free] = inverse_root(precision)
    own = free[: PARAMETERS_PER_BODY * n_bodies].reshape(n_bodies, PARAMETERS_PER_BODY)
    bodies = tuple((own[:, 0] // PARAMETERS_PER_BODY).tolist())
    return Prior(mean, mean, bodies, torch.linalg.inv(pseudo_inertia(mean[own])), kappa, scale)
