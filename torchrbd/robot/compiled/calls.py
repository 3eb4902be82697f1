"""The kernels on tensors: float64, on the CPU, states of one shape. Derivatives are in `operators`.

`pi` is (n_params,) and `gravity` (3,). Or both have a batch, (*batch, n_params) and (*batch, 3): each sample is then a
robot of its own. Derivatives with respect to them have the same shape: sums over the batch in the first case.
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable, Sequence
from pathlib import Path

import torch
from torch import Tensor

from torchrbd._runtime.compiling import ADDRESS, INTEGER, Source, library
from torchrbd.robot.batching import zeros
from torchrbd.robot.compiled.tables import Tables

_TABLES = (ADDRESS, ADDRESS, INTEGER)
KERNELS = Source(
    Path(__file__).parent,
    ("kernels.c", "lanes.h", "log_cholesky.h", "mass_matrix.h", "motion.h", "regressor.h", "torque.h", "work.h"),
    {
        "inverse_dynamics": (*_TABLES, INTEGER, INTEGER, *[ADDRESS] * 6),
        "inverse_dynamics_adjoint": (*_TABLES, INTEGER, INTEGER, *[ADDRESS] * 11),
        "physical_torque": (*_TABLES, INTEGER, *[ADDRESS] * 6),
        "torque_slopes": (*_TABLES, INTEGER, *[ADDRESS] * 6),
        "regressor": (*_TABLES, INTEGER, INTEGER, *[ADDRESS] * 5),
        "regressor_adjoint": (*_TABLES, INTEGER, INTEGER, *[ADDRESS] * 9),
        "mass_matrix": (*_TABLES, INTEGER, INTEGER, *[ADDRESS] * 3),
        "mass_matrix_adjoint": (*_TABLES, INTEGER, INTEGER, *[ADDRESS] * 5),
        "log_cholesky": (INTEGER, *[ADDRESS] * 2),
        "log_cholesky_adjoint": (INTEGER, *[ADDRESS] * 3),
    },
)
"""One library for all robots: the robot is an argument of each call, as tables."""

LARGE = 1 << 19
"""Count of numbers from which numpy asks for large pages."""


def inverse_dynamics(tables: Tables, q: Tensor, qd: Tensor, qdd: Tensor, pi: Tensor, gravity: Tensor) -> Tensor:
    """Return the torques, (*batch, n_dof)."""
    (q, qd, qdd), last = _laid_out(q, qd, qdd)
    tau = torch.empty_like(q)
    flags = last, pi.ndim > 1
    _run(_kernels().inverse_dynamics, tables, q, flags, q, qd, qdd, pi.contiguous(), gravity.contiguous(), tau)
    return tau


def inverse_dynamics_adjoint(
    tables: Tables,
    q: Tensor,
    qd: Tensor,
    qdd: Tensor,
    pi: Tensor,
    gravity: Tensor,
    weight: Tensor,
    wanted: Sequence[bool] = (True,) * 5,
) -> tuple[Tensor | None, ...]:
    """Return the derivatives of `(weight * tau).sum()` with respect to q, qd, qdd, pi and gravity.

    Args:
        weight: (*batch, n_dof).
        wanted: which of the five; those for states and gravity come together.
    """
    (q, qd, qdd, weight), last = _laid_out(q, qd, qdd, weight)
    pi, gravity = pi.contiguous(), gravity.contiguous()
    moving = wanted[0] or wanted[1] or wanted[2] or wanted[4]
    by_states = [torch.empty_like(q) for _ in range(3)] if moving else [None] * 3
    by_pi = torch.empty_like(pi) if wanted[3] else None
    by_gravity = torch.zeros_like(gravity) if moving else None  # an empty batch writes nothing
    found = (*by_states, by_pi, by_gravity)
    each = pi.ndim > 1
    _run(_kernels().inverse_dynamics_adjoint, tables, q, (last, each), q, qd, qdd, pi, gravity, weight, *found)
    return found


def physical_torque(tables: Tables, q: Tensor, qd: Tensor, qdd: Tensor, theta: Tensor, gravity: Tensor) -> Tensor:
    """Return the torques, (*batch, n_dof), of one robot given its log-Cholesky coordinates, (n_bodies, 10)."""
    (q, qd, qdd), last = _laid_out(q, qd, qdd)
    tau = torch.empty_like(q)
    _run(_kernels().physical_torque, tables, q, (last,), q, qd, qdd, theta.contiguous(), gravity.contiguous(), tau)
    return tau


def torque_slopes(tables: Tables, q: Tensor, qd: Tensor, qdd: Tensor, pi: Tensor, gravity: Tensor) -> Tensor:
    """Return the derivatives of one robot's torques with respect to q, qd and qdd, (*batch, 3, n_dof, n_dof)."""
    (q, qd, qdd), last = _laid_out(q, qd, qdd)
    slopes = _room(q, *q.shape[:-1], 3, q.shape[-1], q.shape[-1])
    _run(_kernels().torque_slopes, tables, q, (last,), q, qd, qdd, pi.contiguous(), gravity.contiguous(), slopes)
    return slopes


def regressor(tables: Tables, q: Tensor, qd: Tensor, qdd: Tensor, gravity: Tensor) -> Tensor:
    """Return the regressor, (*batch, n_dof, n_params), a view: the samples are contiguous in memory."""
    (q, qd, qdd), last = _laid_out(q, qd, qdd)
    n_dof, batch = q.shape[-1], q.shape[:-1]
    n_params = tables.constants.numel() // 35 * 10
    if batch.numel() == 1:
        Y = q.new_zeros((*batch, n_dof, n_params))
        _run(_kernels().regressor, tables, q, (last, gravity.ndim > 1), q, qd, qdd, gravity.contiguous(), Y)
        return Y
    Y = zeros(q, n_dof, n_params, batch.numel())
    _run(_kernels().regressor, tables, q, (last, gravity.ndim > 1), q, qd, qdd, gravity.contiguous(), Y)
    return Y.movedim(-1, 0).unflatten(0, batch)


def regressor_adjoint(
    tables: Tables, q: Tensor, qd: Tensor, qdd: Tensor, gravity: Tensor, weight: Tensor, wanted: object = None
) -> tuple[Tensor, ...]:
    """Return the derivatives of `(weight * Y).sum()` with respect to q, qd, qdd and gravity, all four for any `wanted`.

    Args:
        weight: (*batch, n_dof, n_params).
    """
    (q, qd, qdd), last = _laid_out(q, qd, qdd)
    gravity, weight = gravity.contiguous(), weight.reshape(-1, *weight.shape[-2:]).movedim(0, -1).contiguous()
    found = (*(torch.empty_like(q) for _ in range(3)), torch.zeros_like(gravity))
    _run(_kernels().regressor_adjoint, tables, q, (last, gravity.ndim > 1), q, qd, qdd, gravity, weight, *found)
    return found


def mass_matrix(tables: Tables, q: Tensor, pi: Tensor) -> Tensor:
    """Return the mass matrices, (*batch, n_dof, n_dof)."""
    (q,), last = _laid_out(q)
    M = _room(q, *q.shape, q.shape[-1])
    _run(_kernels().mass_matrix, tables, q, (last, pi.ndim > 1), q, pi.contiguous(), M)
    return M


def mass_matrix_adjoint(
    tables: Tables, q: Tensor, pi: Tensor, weight: Tensor, wanted: object = None
) -> tuple[Tensor, ...]:
    """Return the derivatives of `(weight * M).sum()` with respect to q and pi, both for any `wanted`.

    Args:
        weight: (*batch, n_dof, n_dof).
    """
    (q,), last = _laid_out(q)
    pi, found = pi.contiguous(), (torch.empty_like(q), torch.empty_like(pi))
    _run(_kernels().mass_matrix_adjoint, tables, q, (last, pi.ndim > 1), q, pi, weight.contiguous(), *found)
    return found


def log_cholesky(tables: Tables, theta: Tensor) -> Tensor:
    """Return inertial parameters (*batch, 10) of log-Cholesky coordinates (*batch, 10), for any robot."""
    theta = theta.contiguous()
    pi = torch.empty_like(theta)
    _kernels().log_cholesky(theta.numel() // 10, theta.data_ptr(), pi.data_ptr())
    return pi


def log_cholesky_adjoint(tables: Tables, theta: Tensor, weight: Tensor, wanted: object = None) -> tuple[Tensor]:
    """Return the derivatives of `(weight * pi).sum()` with respect to theta, (*batch, 10)."""
    theta, weight = theta.contiguous(), weight.contiguous()
    found = torch.empty_like(theta)
    _kernels().log_cholesky_adjoint(theta.numel() // 10, theta.data_ptr(), weight.data_ptr(), found.data_ptr())
    return (found,)


def _kernels() -> ctypes.CDLL:
    loaded = library(KERNELS)
    assert loaded is not None
    return loaded


def _room(like: Tensor, *shape: int) -> Tensor:
    """Return uninitialised memory, in large pages where it is large."""
    return like.new_empty(shape) if math.prod(shape) < LARGE else zeros(like, *shape)


def _laid_out(*states: Tensor) -> tuple[Sequence[Tensor], int]:
    """Return states as they are in memory, or copies, and a flag: 0 for samples first, 1 for samples last in all."""
    for x in states:
        if not x.is_contiguous():
            break
    else:
        return states, 0
    if all(x.ndim == 2 and x.stride() == (1, len(x)) for x in states):
        return states, 1
    return [x.contiguous() for x in states], 0


def _run(kernel: Callable[..., int], tables: Tables, q: Tensor, flags: tuple[int, ...], *x: Tensor | None) -> None:
    """Call a kernel; `q` gives the number of samples.

    Raises:
        MemoryError: the kernel could not allocate memory.
    """
    addresses = [None if y is None else y.data_ptr() for y in x]
    samples = q.numel() // q.shape[-1]
    if kernel(tables[0].data_ptr(), tables[1].data_ptr(), samples, *flags, *addresses):
        raise MemoryError("no memory for the rigid-body kernels")
