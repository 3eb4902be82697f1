"""Rigid-body dynamics in torch's own operations, samples first: any dtype and device, any derivative, any transform.

The compiled kernels are tested against it; it runs where they cannot.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from torchrbd._runtime.compiling import is_transformed
from torchrbd.robot import dynamics, slopes
from torchrbd.robot.batching import batch_first, batch_last, tiled, tiles, zeros
from torchrbd.robot.kinematics import Geometry


def inverse_dynamics(geometry: Geometry, q: Tensor, qd: Tensor, qdd: Tensor, pi: Tensor, gravity: Tensor) -> Tensor:
    """Return the torques, (*batch, n_dof).

    Args:
        q, qd, qdd: (*batch, n_dof) whose batches broadcast.
        pi: (n_params,).
        gravity: (3,).
    """
    return _tiled(lambda q, qd, qdd: dynamics.inverse_dynamics(geometry, q, qd, qdd, pi, gravity), q, qd, qdd)


def regressor(geometry: Geometry, q: Tensor, qd: Tensor, qdd: Tensor, gravity: Tensor) -> Tensor:
    """Return the regressor, (*batch, n_dof, n_params), a view: the samples are contiguous in memory.

    Args:
        q, qd, qdd, gravity: as of `inverse_dynamics`.
    """
    (q, qd, qdd), batch = batch_last(q, qd, qdd)
    return batch_first(regressor_batch_last(geometry, q, qd, qdd, gravity), batch)


def regressor_batch_last(geometry: Geometry, q: Tensor, qd: Tensor, qdd: Tensor, gravity: Tensor) -> Tensor:
    """Return the regressor, (n_dof, n_params, N), of states (n_dof, N)."""
    tracked = torch.is_grad_enabled() and any(x.requires_grad for x in (q, qd, qdd, gravity))
    if tracked or is_transformed():
        return tiled(lambda q, qd, qdd: dynamics.regressor(geometry, q, qd, qdd, gravity), q, qd, qdd)
    Y = zeros(q, len(q), 10 * len(geometry.ends), q.shape[-1])
    with torch.no_grad():
        for q_k, qd_k, qdd_k, Y_k in tiles(q, qd, qdd, Y):
            dynamics.write_regressor(geometry, q_k, qd_k, qdd_k, gravity, out=Y_k)
    return Y


def mass_matrix(geometry: Geometry, q: Tensor, pi: Tensor) -> Tensor:
    """Return the mass matrices, (*batch, n_dof, n_dof), of positions (*batch, n_dof) and parameters (n_params,)."""
    return _tiled(lambda q: dynamics.mass_matrix(geometry, q, pi), q)


def torque_slopes(geometry: Geometry, q: Tensor, qd: Tensor, qdd: Tensor, pi: Tensor, gravity: Tensor) -> Tensor:
    """Return the derivatives of the torques by q, qd and qdd, (*batch, 3, n_dof, n_dof); arguments as above."""
    return _tiled(lambda q, qd, qdd: slopes.torque_slopes(geometry, q, qd, qdd, pi, gravity), q, qd, qdd)


def origin_slopes(geometry: Geometry, q: Tensor, qd: Tensor, qdd: Tensor, pi: Tensor, gravity: Tensor) -> Tensor:
    """Return the derivatives of the torques by bodies' origins, (*batch, n_dof, n_bodies, 6); arguments as above."""
    return _tiled(lambda q, qd, qdd: slopes.origin_slopes(geometry, q, qd, qdd, pi, gravity), q, qd, qdd)


def _tiled(function: Callable[..., Tensor], *states: Tensor) -> Tensor:
    states, batch = batch_last(*states)
    return batch_first(tiled(function, *states), batch)
