"""Accelerations from a mass matrix, with an error that names the joint if the matrix is not positive definite."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from torchrbd.errors import PhysicalError


def accelerations(mass: Tensor, tau: Tensor, robot: str, joints: Sequence[str]) -> Tensor:
    """Return `M^-1 tau`, (*batch, n_dof).

    Args:
        mass: (*batch, n_dof, n_dof) mass matrices.
        tau: (*batch, n_dof) torque available for acceleration.
        robot: its name, for messages.
        joints: (n_dof,) their names.

    Raises:
        PhysicalError: a mass matrix is not positive definite.
    """
    try:
        factor = torch.linalg.cholesky(mass)
    except torch.linalg.LinAlgError:  # pyright: ignore[reportPrivateImportUsage]
        _, info = torch.linalg.cholesky_ex(mass)
        joint = joints[int(info[info > 0].flatten()[0]) - 1]
        raise PhysicalError(
            f"robot '{robot}': the mass matrix is not positive definite at {int((info > 0).sum())} of "
            f"{info.numel()} positions, first at joint '{joint}': what it moves is massless or has inertial "
            "parameters that no rigid body can have; give it mass and inertia or the joint a rotor "
            "inertia, or use physically valid parameters"
        ) from None
    return torch.cholesky_solve(tau.unsqueeze(-1), factor).squeeze(-1)
