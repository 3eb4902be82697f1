"""Inertial parameters of one body and their transformation between frames."""

from __future__ import annotations

import torch
from torch import Tensor

PARAMETERS = ("m", "mcx", "mcy", "mcz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
"""Order of a body's inertial parameters: mass, first moment and inertia about the body's origin [kg, kg m, kg m^2]."""


def inertia_matrix(pi: Tensor) -> Tensor:
    """Return the inertia matrix about the origin.

    Args:
        pi: (..., 10) inertial parameters.

    Returns:
        (..., 3, 3) inertia [kg m^2].
    """
    return pi[..., [4, 5, 7, 5, 6, 8, 7, 8, 9]].unflatten(-1, (3, 3))


def pseudo_inertia(pi: Tensor) -> Tensor:
    """Return the 4x4 pseudo-inertia `J = [[S, m c], [(m c)', m]]`, `S = tr(I)/2 - I` the second moment of mass.

    Args:
        pi: (..., 10) inertial parameters.

    Returns:
        (..., 4, 4), positive definite for a physical body.

    Source: Wensing, Kim, Slotine (2018), Linear matrix inequalities for physically consistent inertial parameter
        identification, eq. 6.
    """
    inertia = inertia_matrix(pi)
    trace = inertia.diagonal(dim1=-2, dim2=-1).sum(-1)[..., None, None]
    second = trace / 2 * torch.eye(3, dtype=pi.dtype, device=pi.device) - inertia
    top = torch.cat((second, pi[..., 1:4, None]), -1)
    return torch.cat((top, torch.cat((pi[..., 1:4], pi[..., :1]), -1)[..., None, :]), -2)


def from_pseudo_inertia(pseudo: Tensor) -> Tensor:
    """Return the inertial parameters of a pseudo-inertia: the inverse of `pseudo_inertia`.

    Args:
        pseudo: (..., 4, 4).

    Returns:
        (..., 10) inertial parameters.
    """
    second = pseudo[..., :3, :3]
    trace = second.diagonal(dim1=-2, dim2=-1).sum(-1)[..., None, None]
    inertia = trace * torch.eye(3, dtype=pseudo.dtype, device=pseudo.device) - second
    return torch.cat((pseudo[..., 3, [3, 0, 1, 2]], inertia.flatten(-2)[..., [0, 1, 4, 2, 5, 8]]), -1)


def transform_inertia(pi: Tensor, pose: Tensor) -> Tensor:
    """Express inertial parameters in another frame: `J_a = T J_b T'`.

    Args:
        pi: (..., 10) about the origin of frame b, in its axes.
        pose: (..., 4, 4) pose T of frame b in frame a.

    Returns:
        (..., 10) about the origin of frame a, in its axes.
    """
    return from_pseudo_inertia(pose @ pseudo_inertia(pi) @ pose.mT)
