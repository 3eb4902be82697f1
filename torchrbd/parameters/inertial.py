"""What makes inertial parameters physical: a positive definite pseudo-inertia.

    J = [[Sigma, h], [h', m]],   Sigma = 1/2 tr(I) 1 - I,   h = m c

with I the rotational inertia about the body origin. J > 0 says m > 0 and that the mass density has a positive second
moment in every direction, which contains the triangle inequalities.

Source: Wensing, Kim, Slotine, "Linear Matrix Inequalities for Physically Consistent Inertial Parameter Identification",
IEEE RA-L 2018, eq. (14) to (16).
"""

from __future__ import annotations

import torch
from torch import Tensor

from torchrbd.robot import PARAMETERS, from_pseudo_inertia, pseudo_inertia

PARAMETERS_PER_BODY = len(PARAMETERS)
UNITS = ("kg", "kg m", "kg m", "kg m", *("kg m^2",) * 6)
BASIS = pseudo_inertia(torch.eye(PARAMETERS_PER_BODY, dtype=torch.float64))
"""E (10, 4, 4) with J = sum_k pi_k E_k."""


def central_covariance(pi: Tensor) -> Tensor:
    """Return Sigma - h h' / m (*batch, 3, 3), [kg m^2]: the second moment of the mass about its own centre."""
    J, h = pseudo_inertia(pi), pi[..., 1:4]
    return J[..., :3, :3] - h.unsqueeze(-1) * h.unsqueeze(-2) / pi[..., 0, None, None]


def is_physical(pi: Tensor, tolerance: float = 1e-10) -> Tensor:
    """Say which bodies (*batch,) have m > 0 and central second moments above ``tolerance`` times its trace."""
    heavy = pi[..., 0] > 0
    sigma = central_covariance(torch.where(heavy.unsqueeze(-1), pi, torch.ones_like(pi)))
    eigenvalues = torch.linalg.eigvalsh(sigma)
    return heavy & (eigenvalues[..., 0] > tolerance * eigenvalues.sum(-1).clamp_min(0.0))


def nearest_physical(pi: Tensor, thinness: float = 0.05) -> Tensor:
    """Replace unphysical bodies by near physical ones of the same mass and centre; leave the physical ones untouched.

    The central covariance is brought to principal axes and its eigenvalues are raised to at least m (thinness r)^2,
    with r the body's radius of gyration about its origin (1 cm for a point mass there).

    Args:
        pi: (*batch, 10), every mass positive.
        thinness: least radius of gyration in any direction, as a fraction of r.
    """
    m, c = pi[..., 0], pi[..., 1:4] / pi[..., 0, None]
    eigenvalues, axes = torch.linalg.eigh(central_covariance(pi))
    radius_sq = eigenvalues.clamp_min(0.0).sum(-1) / m + c.square().sum(-1)
    radius_sq = torch.where(radius_sq > 0, radius_sq, torch.full_like(radius_sq, 1e-4))
    raised = torch.maximum(eigenvalues, (m * thinness**2 * radius_sq).unsqueeze(-1))
    J = pseudo_inertia(pi)
    J[..., :3, :3] = axes @ torch.diag_embed(raised) @ axes.mT + m[..., None, None] * c.unsqueeze(-1) * c.unsqueeze(-2)
    return torch.where(is_physical(pi).unsqueeze(-1), pi, from_pseudo_inertia(J))
