"""Learning rates for optimisers that step every number alike, as Adam: by what a step does to the torque."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from torchrbd.errors import InputError
from torchrbd.learning.coordinates import felt, physics_columns
from torchrbd.model import RigidBodyDynamics


@torch.no_grad()
def parameter_groups(
    model: RigidBodyDynamics, q: Tensor, qd: Tensor, qdd: Tensor, tau: Tensor, t: Tensor | None = None, lr: float = 1e-2
) -> list[dict[str, Any]]:
    """Return one group for the inertia and one for each term: ``torch.optim.Adam(parameter_groups(...))``.

    Log-Cholesky coordinates are logarithms or parts of a body's size, so that ``lr`` changes a body by that part; a
    coefficient's rate changes its term's torque by that part of its joint's,

        lr_k = lr max_j rms(tau_j) / rms(phi_jk)

    Args:
        model: whose parameters are grouped.
        q, qd, qdd, tau: (*batch, n_dof) of the data, or some thousands of samples.
        t: as of ``RigidBodyDynamics.forward``.
        lr: rate of the inertia [-].

    Raises:
        InputError: the torques are not finite.
    """
    if not bool(torch.isfinite(tau).all()):
        raise InputError("parameter_groups: tau has values that are not finite; drop these samples")
    groups: list[dict[str, Any]] = [{"params": [model.raw_inertia], "lr": lr}]
    sizes = felt(physics_columns(model, q, qd, qdd, t)[..., model.robot.n_params :], tau)
    for term, own in zip(model.terms, sizes.split([len(term.coefficients) for term in model.terms]), strict=True):
        size = float(own.amax())
        groups.append({"params": [term.coefficients], "lr": lr / size if size > 0.0 else lr})
    return groups
