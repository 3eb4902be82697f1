"""Torque around a trajectory: residuals, and their slopes in the spline coefficients and in x.

    tau_f = F [Y(s(c)) x] + noise,   d tau_f = F [D_q B dc + D_qd B' dc + D_qdd B'' dc] + F[Y] dx

F the torque filter, B the spline basis, D the slopes of the inverse dynamics. A torque sample depends on so many
coefficients of every joint as make one block, so that the system is block tridiagonal.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from torchrbd.dataset.block_statistics import filtered_rows
from torchrbd.dataset.columns import Columns
from torchrbd.inference.physical.fitting import predict
from torchrbd.inference.smoothing.spline import Grid
from torchrbd.inference.smoothing.stretch import Stretch
from torchrbd.recordings import States


@dataclass(frozen=True)
class Linearisation:
    """Residuals and slopes of a stretch.

    Attributes:
        residual: (O, n).
        Y: (O, n, n_columns) band-limited columns of x.
        J: (n_blocks - 1, outputs_per_block n, 2 block n) slopes in c; the rows are the torques that begin in a block,
            the columns the coefficients of this block and the next.
    """

    residual: Tensor
    Y: Tensor
    J: Tensor


def states_at_instants(stretch: Stretch, c: Tensor) -> States:
    """Return the states of coefficients c (K, n) where the dynamics are evaluated; differentiable in c."""
    grid = stretch.grid
    q, qd, qdd = (grid.basis @ c).mT
    t = torch.from_numpy(grid.instants)
    t_out = t[grid.reach : len(t) - grid.reach : grid.substeps]
    return States(
        stretch.segment,
        grid.step,
        t,
        q,
        qd,
        qdd,
        torch.zeros_like(q),
        t_out,
        _kernel=grid.kernel,
        _torque_kernel=grid.kernel,
        _stride=grid.substeps,
        recording="",
    )


def residual(columns: Columns, stretch: Stretch, c: Tensor, x: Tensor) -> Tensor:
    """Return measured minus predicted band-limited torque (O, n); differentiable in c and x."""
    states = states_at_instants(stretch, c)
    return stretch.tau - states.decimate(predict(columns, x, states)).T


def linearise(columns: Columns, stretch: Stretch, c: Tensor, x: Tensor) -> Linearisation:
    """Linearise the torque of a stretch around coefficients c (K, n) and x (n_columns,)."""
    grid, n = stretch.grid, columns.robot.n_dof
    states = states_at_instants(stretch, c)
    rows, _ = filtered_rows(columns, states)
    Y = c.new_zeros(grid.outputs, n, columns.n)
    for joint, own in enumerate(columns.of_joint):
        Y[:, joint, own] = rows[joint][:-1].T
    seen = _slopes(columns, states, x).unfold(-1, 2 * grid.reach + 1, grid.substeps).permute(3, 0, 2, 1, 4)
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
    rows, shift, block = grid.outputs_per_block, grid.per_output, grid.block
    blocks = J.new_zeros(-(-outputs // rows), rows, n, 2 * block, n)
    for place in range(rows):
        own = J[place::rows].transpose(2, 3)
        blocks[: len(own), place, :, shift * place : shift * place + width] = own
    return blocks.reshape(len(blocks), rows * n, 2 * block * n)
