"""The pseudo-inertia matrix: a body's ten inertial parameters as a 4x4 matrix that is positive definite iff they are physical.

    J = [[Sigma, h], [h', m]],   Sigma = 1/2 tr(I) 1 - I,   h = m c

with I the rotational inertia about the body origin. J > 0 says m > 0 and that the mass density has a positive second
moment in every direction, which contains the triangle inequalities.

Source: Wensing, Kim, Slotine, "Linear Matrix Inequalities for Physically Consistent Inertial Parameter Identification",
IEEE RA-L 2018, eq. (14) to (16).
"""

from __future__ import annotations

import torch
from torch import Tensor

PARAMETERS_PER_BODY = 10
UNITS = ("kg", "kg m", "kg m", "kg m", *("kg m^2",) * 6)


def _pseudo_inertia_basis() -> Tensor:
    """Return E (10, 4, 4) with J = sum_k pi_k E_k."""
    basis = torch.zeros(PARAMETERS_PER_BODY, 4, 4, dtype=torch.float64)
    basis[0, 3, 3] = 1.0
    for axis in range(3):
        basis[1 + axis, axis, 3] = basis[1 + axis, 3, axis] = 1.0
    diagonal, off_diagonal = {4: 0, 6: 1, 9: 2}, {5: (0, 1), 7: (0, 2), 8: (1, 2)}
    for k, axis in diagonal.items():
        basis[k, :3, :3] = 0.5 * torch.eye(3, dtype=torch.float64)
        basis[k, axis, axis] -= 1.0
    for k, (row, column) in off_diagonal.items():
        basis[k, row, column] = basis[k, column, row] = -1.0
    return basis


BASIS = _pseudo_inertia_basis()


def pseudo_inertia(pi: Tensor) -> Tensor:
    """Return the pseudo-inertia J = sum_k pi_k E_k.

    Args:
        pi: (*batch, 10) inertial parameters about the body origin.

    Returns:
        (*batch, 4, 4), [kg m^2, kg m; kg m, kg].
    """
    return torch.einsum("...k,kab->...ab", pi, BASIS.to(pi))


def inertial_parameters(J: Tensor) -> Tensor:
    """Return pi (*batch, 10) of a pseudo-inertia (*batch, 4, 4): the inverse of ``pseudo_inertia``; I = tr(Sigma) 1 - Sigma."""
    sigma, trace = J[..., :3, :3], J[..., :3, :3].diagonal(dim1=-2, dim2=-1).sum(-1)
    return torch.stack(
        (
            J[..., 3, 3], J[..., 0, 3], J[..., 1, 3], J[..., 2, 3],
            trace - sigma[..., 0, 0], -sigma[..., 0, 1], trace - sigma[..., 1, 1],
            -sigma[..., 0, 2], -sigma[..., 1, 2], trace - sigma[..., 2, 2],
        ),
        dim=-1,
    )  # fmt: skip


def central_covariance(pi: Tensor) -> Tensor:
    """Return Sigma - h h' / m (*batch, 3, 3), [kg m^2]: the second moment of the mass about its own centre."""
    J, h = pseudo_inertia(pi), pi[..., 1:4]
    return J[..., :3, :3] - h.unsqueeze(-1) * h.unsqueeze(-2) / pi[..., 0, None, None]


def is_physical(pi: Tensor, tolerance: float = 1e-10) -> Tensor:
    """Say which bodies (*batch,) have m > 0 and a central covariance that is positive definite beyond ``tolerance`` times its trace."""
    heavy = pi[..., 0] > 0
    sigma = central_covariance(torch.where(heavy.unsqueeze(-1), pi, torch.ones_like(pi)))
    eigenvalues = torch.linalg.eigvalsh(sigma)
    return heavy & (eigenvalues[..., 0] > tolerance * eigenvalues.sum(-1).clamp_min(0.0))


def nearest_physical(pi: Tensor, thinness: float = 0.05) -> Tensor:
    """Replace unphysical bodies by near physical ones of the same mass and centre; leave the physical ones untouched.

    The central covariance is brought to principal axes and its eigenvalues are raised to at least m (thinness r)^2, with
    r the body's radius of gyration about its origin (1 cm for a point mass there).

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
    return torch.where(is_physical(pi).unsqueeze(-1), pi, inertial_parameters(J))
