"""Torque around a trajectory: residuals, and their slopes in the spline coefficients and in x.

    tau_f = F [Y(s(c)) x] + noise,   d tau_f = F [D_q B dc + D_qd B' dc + D_qdd B'' dc] + F[Y] dx

F the torque filter, B the spline basis, D the slopes of the inverse dynamics. A torque sample depends on ``width``
coefficients of every joint, so that ``width`` of them make one block of a block tridiagonal system.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from torchrbd.inference.block_statistics import filtered_rows
from torchrbd.inference.columns import Columns
from torchrbd.inference.fitting import predict
from torchrbd.inference.smoothing.spline import Grid
from torchrbd.inference.smoothing.stretch import Stretch
from torchrbd.recordings import States


@dataclass(frozen=True)
class Linearisation:
    """Residuals and slopes of a stretch.

    Attributes:
        residual: (O, n).
        Y: (O, n, n_columns) band-limited columns of x.
        J: (n_blocks - 1, width n, 2 width n) slopes in c; the rows of a block are its torques, its columns the
            coefficients of this block and the next.
    """

    residual: Tensor
    Y: Tensor
    J: Tensor


def half_knot_states(stretch: Stretch, c: Tensor) -> States:
    """Return the states of coefficients c (K, n) at the half knots; differentiable in c."""
    grid = stretch.grid
    q, qd, qdd = (grid.half_knot_basis @ c).mT
    t = torch.from_numpy(grid.half_knots)
    t_out = t[grid.half : len(t) - grid.half : 2]
    step = 0.5 * grid.spacing
    return States(stretch.segment, step, t, q, qd, qdd, torch.zeros_like(q), t_out, _kernel=grid.kernel, _stride=2)


def residual(columns: Columns, stretch: Stretch, c: Tensor, x: Tensor) -> Tensor:
    """Return measured minus predicted band-limited torque (O, n); differentiable in c and x."""
    states = half_knot_states(stretch, c)
    return stretch.tau - states.decimate(predict(columns, x, states)).T


def linearise(columns: Columns, stretch: Stretch, c: Tensor, x: Tensor) -> Linearisation:
    """Linearise the torque of a stretch around coefficients c (K, n) and x (n_columns,)."""
    grid, n = stretch.grid, columns.robot.n_dof
    states = half_knot_states(stretch, c)
    rows, _ = filtered_rows(columns, states)
    Y = c.new_zeros(grid.outputs, n, columns.n)
    for joint, own in enumerate(columns.of_joint):
        Y[:, joint, own] = rows[joint][:-1].T
    seen = _slopes(columns, states, x).unfold(-1, 2 * grid.half + 1, 2).permute(3, 0, 2, 1, 4)
    J = seen.flatten(3) @ grid.filtered_basis
    return Linearisation(stretch.tau - torch.einsum("ojk,k->oj", Y, x), Y, in_blocks(grid, J))


def _slopes(columns: Columns, states: States, x: Tensor) -> Tensor:
    """Return d tau_j / d (q, qd, qdd)_i at all N samples, (n, 3, n, N): indices j, derivative, i."""
    q, qd, qdd = (signal.detach().requires_grad_(True) for signal in (states.q, states.qd, states.qdd))
    torque = predict(columns, x.detach(), replace(states, q=q, qd=qd, qdd=qdd))
    rows = [
        torch.autograd.grad(tau_j.sum(), (q, qd, qdd), retain_graph=True, materialize_grads=True) for tau_j in torque
    ]
    return torch.stack([torch.stack(row) for row in rows])


def in_blocks(grid: Grid, J: Tensor) -> Tensor:
    """Place slopes (O, n, n, width), of torque j in joint i's coefficients, in blocks; see ``Linearisation``."""
    outputs, n, _, width = J.shape
    n_blocks = -(-outputs // width)
    blocks = J.new_zeros(n_blocks, width, n, 2 * width, n)
    for place in range(width):
        rows = J[place::width].transpose(2, 3)
        blocks[: len(rows), place, :, place : place + width] = rows
    return blocks.reshape(n_blocks, width * n, 2 * width * n)
