"""Physical consistency of inertial parameters: a positive definite pseudo-inertia.

    J = [[Sigma, h], [h', m]],   Sigma = 1/2 tr(I) 1 - I,   h = m c

I is the rotational inertia about the body's origin. J > 0 means that m > 0 and that the mass density has a positive
second moment in every direction, which includes the triangle inequalities.

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


def _orthonormal() -> Tensor:
    B = torch.zeros(PARAMETERS_PER_BODY, 4, 4, dtype=torch.float64)
    for k, (i, j) in enumerate(torch.triu_indices(4, 4).T.tolist()):
        B[k, i, j] = B[k, j, i] = 1.0 if i == j else 0.5**0.5
    return B


ORTHONORMAL = _orthonormal()
"""B (10, 4, 4), a basis of the symmetric matrices with tr(B_k B_l) = 1 for k = l, otherwise 0."""


def central_covariance(pi: Tensor) -> Tensor:
    """Return Sigma - h h' / m (*batch, 3, 3), [kg m^2]: the second moment of the mass about its own centre."""
    J, h = pseudo_inertia(pi), pi[..., 1:4]
    return J[..., :3, :3] - h.unsqueeze(-1) * h.unsqueeze(-2) / pi[..., 0, None, None]


def is_physical(pi: Tensor, tolerance: float = 1e-10) -> Tensor:
    """Return which bodies (*batch,) have m > 0 and central second moments above ``tolerance`` times their trace."""
    heavy = pi[..., 0] > 0
    sigma = central_covariance(torch.where(heavy.unsqueeze(-1), pi, torch.ones_like(pi)))
    eigenvalues = torch.linalg.eigvalsh(sigma)
    return heavy & (eigenvalues[..., 0] > tolerance * eigenvalues.sum(-1).clamp_min(0.0))


def is_extended(pi: Tensor, thinness: float = 0.05) -> Tensor:
    """Return which bodies (*batch,) are physical and wider than ``thinness`` times r in some direction.

    r is the radius of gyration about the body's origin. Placeholder inertias are often a thousand times too small.
    """
    physical = is_physical(pi)
    pi = torch.where(physical.unsqueeze(-1), pi, torch.ones_like(pi))
    eigenvalues = torch.linalg.eigvalsh(central_covariance(pi))
    return physical & (eigenvalues[..., -1] > thinness**2 * _second_moment(pi, eigenvalues))


def _second_moment(pi: Tensor, eigenvalues: Tensor) -> Tensor:
    """Return m r^2 about the origin (*batch,), with r = 1 cm for a point mass there."""
    m, h = pi[..., 0], pi[..., 1:4]
    moment = eigenvalues.clamp_min(0.0).sum(-1) + h.square().sum(-1) / m
    return torch.where(moment > 0, moment, 1e-4 * m)


def nearest_physical(pi: Tensor, thinness: float = 0.05, width: float = 0.3) -> Tensor:
    """Replace bodies that are not extended by near ones with the same mass and centre; do not change the others.

    The central covariance is brought to principal axes and its eigenvalues are raised to at least m (thinness r)^2,
    with r the body's radius of gyration about its origin. Those of a point mass are raised to m (width r)^2.

    Args:
        pi: (*batch, 10), every mass positive.
        thinness: least radius of gyration in any direction, as a fraction of r.
        width: radius of gyration of a point mass in all directions, as a fraction of r.
    """
    return torch.where(is_extended(pi, thinness).unsqueeze(-1), pi, _raised(pi, thinness, width))


def thickened(pi: Tensor, thinness: float = 0.1) -> Tensor:
    """Return physical bodies that are nowhere thinner than a fraction of their radius of gyration about the origin.

    A needle as a prior means that the direction of its axis is known as precisely as it is thin. No drawing of a link
    is that precise: an error of its direction by an angle adds a second moment of angle^2 m r^2 across.

    Args:
        pi: (*batch, 10), every one physical.
        thinness: least radius of gyration in any direction, as a fraction of r.
    """
    eigenvalues = torch.linalg.eigvalsh(central_covariance(pi))
    thin = eigenvalues[..., 0] < thinness**2 * _second_moment(pi, eigenvalues)
    return torch.where(thin.unsqueeze(-1), _raised(pi, thinness, thinness), pi)


def _raised(pi: Tensor, thinness: float, width: float) -> Tensor:
    """Return bodies with central eigenvalues of at least m (thinness r)^2, or m (width r)^2 for a point mass."""
    m, c = pi[..., 0], pi[..., 1:4] / pi[..., 0, None]
    eigenvalues, axes = torch.linalg.eigh(central_covariance(pi))
    least = _second_moment(pi, eigenvalues)
    pointlike = eigenvalues[..., -1] <= thinness**2 * least
    least = torch.where(pointlike, width**2 * least, thinness**2 * least)
    raised = torch.maximum(eigenvalues, least.unsqueeze(-1))
    J = pseudo_inertia(pi)
    J[..., :3, :3] = axes @ torch.diag_embed(raised) @ axes.mT + m[..., None, None] * c.unsqueeze(-1) * c.unsqueeze(-2)
    return from_pseudo_inertia(J)
