"""Log-Cholesky coordinates: ten unconstrained numbers per body; all values give a physical body.

    J = U U',   U = e^alpha [[e^d1, s12, s13, t1], [0, e^d2, s23, t2], [0, 0, e^d3, t3], [0, 0, 0, 1]]

theta = [alpha, d1, d2, d3, s12, s23, s13, t1, t2, t3] <-> J > 0 is a bijection; m = e^(2 alpha), c = t.

Source: Rucker, Wensing, "Smooth Parameterization of Rigid-Body Inertia", IEEE RA-L 2022, eq. (8) to (11).
"""

from __future__ import annotations

import torch
from torch import Tensor

from torchrbd.errors import PhysicalError
from torchrbd.robot import compiled, from_pseudo_inertia, pseudo_inertia


def from_log_cholesky(theta: Tensor) -> Tensor:
    """Return the inertial parameters pi (*batch, 10) of log-Cholesky coordinates theta (*batch, 10)."""
    found = compiled.call(_KERNEL, compiled.NO_ROBOT, theta)
    return _from_log_cholesky(theta) if found is None else found


def _from_log_cholesky(theta: Tensor) -> Tensor:
    """Return the same in torch's own operations."""
    alpha, d1, d2, d3, s12, s23, s13, t1, t2, t3 = theta.unbind(-1)
    zero, one = torch.zeros_like(alpha), torch.ones_like(alpha)
    rows = (d1.exp(), s12, s13, t1, zero, d2.exp(), s23, t2, zero, zero, d3.exp(), t3, zero, zero, zero, one)
    U = alpha.exp()[..., None, None] * torch.stack(rows, -1).unflatten(-1, (4, 4))
    return from_pseudo_inertia(U @ U.mT)


_KERNEL = compiled.log_cholesky_kernel(_from_log_cholesky)


def to_log_cholesky(pi: Tensor) -> Tensor:
    """Return the log-Cholesky coordinates theta (*batch, 10) of physical inertial parameters.

    Raises:
        PhysicalError: the pseudo-inertia of a body is not positive definite.
    """
    reverse = [3, 2, 1, 0]
    # The upper triangular factor is the lower one of the matrix with rows and columns reversed.
    lower, info = torch.linalg.cholesky_ex(pseudo_inertia(pi)[..., reverse, :][..., reverse])
    if bool((info != 0).any()):
        bad = torch.nonzero(info.reshape(-1)).flatten().tolist()
        raise PhysicalError(
            f"bodies number {bad} have no positive definite pseudo-inertia, so no log-Cholesky coordinates; "
            "use nearest_physical first"
        )
    U = lower[..., reverse, :][..., reverse]
    scaled = U / U[..., 3, 3, None, None]
    d = scaled.diagonal(dim1=-2, dim2=-1)[..., :3].log()
    entries = (scaled[..., 0, 1], scaled[..., 1, 2], scaled[..., 0, 2])
    return torch.cat((U[..., 3, 3, None].log(), d, torch.stack(entries, -1), scaled[..., :3, 3]), -1)
