"""What one stretch says of x once its own trajectory is eliminated.

    H = J'WJ + B'B / sigma_q^2,   E = J'WY,   g = J'Wr + B'B (c0 - c) / sigma_q^2

c follows x along c^(x) = c + H^-1 (g - E dx), so that the profile likelihood has the curvature S = Y'WY - E'H^-1 E and
the slope Y'Wr - E'H^-1 g.

Source: Golub, Pereyra, "The differentiation of pseudo-inverses and nonlinear least squares problems whose variables
separate", SIAM J. Numer. Anal. 1973.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import torch
from torch import Tensor

from torchrbd.dataset.columns import Columns
from torchrbd.inference.physical.uncertain_states import UncertainStates
from torchrbd.inference.smoothing.block_tridiagonal import BlockCholesky, fold, fold_rows
from torchrbd.inference.smoothing.linearisation import Linearisation, linearise
from torchrbd.inference.smoothing.stretch import Stretch


@dataclass(frozen=True)
class Information:
    """Sums over stretches.

    Attributes:
        gram: Y'WY (k, k) of k wanted columns, the information if the states were known.
        lost: E'H^-1 E (k, k), what their uncertainty takes away.
        slope: Y'Wr - E'H^-1 g (k,).
        count: (n_dof,) independent torque samples.
        spread: (n_dof,) sum of their variances for uncertain states, diag(J H^-1 J').
        samples: encoder samples.
        wander: (n_dof,) sum of the trajectory's variances at the encoder samples, diag(B H^-1 B').
        entropy: -1/2 log det H.
        velocity_noise: (n_dof,) posterior variance of the velocity, median over a stretch, times its torque samples.
        outputs: torque samples.
    """

    gram: Tensor
    lost: Tensor
    slope: Tensor
    count: Tensor
    spread: Tensor
    samples: int
    wander: Tensor
    entropy: Tensor
    velocity_noise: Tensor
    outputs: int

    def __add__(self, other: Information) -> Information:
        return Information(*(getattr(self, f.name) + getattr(other, f.name) for f in fields(self)))

    def uncertain_states(self, torque_variance: Tensor) -> UncertainStates:
        """Return what the states take from the information on all columns, at a torque noise (n_dof,)."""
        used = self.spread / (torque_variance * self.count.clamp_min(1e-300))
        return UncertainStates(self.gram, self.lost, used, torque_variance)


def distance(stretch: Stretch, c: Tensor) -> Tensor:
    """Return |q_m - B c|^2 of each joint (n,); differentiable."""
    away = c - stretch.encoder
    return stretch.misfit + (away * (stretch.gram @ away)).sum(0)


def eliminate(
    columns: Columns,
    stretch: Stretch,
    c: Tensor,
    x: Tensor,
    torque_variance: Tensor,
    encoder_variance: Tensor,
    wanted: Tensor,
) -> tuple[Information, Tensor]:
    """Return what a stretch says of the ``wanted`` columns of x, and the step H^-1 g of its coefficients c (K, n)."""
    at = linearise(columns, stretch, c, x)
    n, block = columns.robot.n_dof, stretch.grid.block
    weight = (stretch.counts / torque_variance).sqrt()
    J, Y, r = _weighted(at, weight, wanted, stretch.grid.outputs_per_block)
    pull = (stretch.gram @ (stretch.encoder - c)) / encoder_variance
    gram = _blocks(stretch.gram, block, len(J) + 1)
    diagonal_data, below_data = (
        torch.einsum("bkl,ij->bkilj", G, torch.diag(1 / encoder_variance)).flatten(3, 4).flatten(1, 2) for G in gram
    )
    diagonal, below = fold(J.mT @ J)
    # coefficients that only fill up the last block have nothing else on their diagonal
    filled = torch.cat(
        (c.new_zeros(c.numel()), c.new_ones(diagonal_data.shape[0] * diagonal_data.shape[1] - c.numel()))
    )
    factor = BlockCholesky.of(
        diagonal + diagonal_data + torch.diag_embed(filled.reshape(len(diagonal_data), -1)), below + below_data
    )
    g = fold_rows(J.mT @ r.unsqueeze(-1)) + _padded(pull, block, len(J) + 1).unsqueeze(-1)
    half = factor.half_solve(torch.cat((g, fold_rows(J.mT @ Y)), -1)).flatten(0, 1)
    covariance = factor.inverse_windows()
    leverage = ((J @ covariance) * J).sum(-1).reshape(-1, n)[: stretch.grid.outputs]
    step = factor.back_solve(half[:, :1].unflatten(0, g.shape[:2])).reshape(-1, n)[: len(c)]
    flat = Y.flatten(0, 1)
    found = Information(
        gram=flat.T @ flat,
        lost=half[:, 1:].T @ half[:, 1:],
        slope=flat.T @ r.flatten() - half[:, 1:].T @ half[:, 0],
        count=stretch.counts.sum(0),
        spread=leverage.sum(0) * torque_variance,
        samples=stretch.samples,
        wander=_wander(gram, covariance, n, block),
        entropy=-0.5 * factor.logdet(),
        velocity_noise=stretch.grid.outputs * _velocity_variance(covariance, n, block, stretch.grid.spacing),
        outputs=stretch.grid.outputs,
    )
    return found, step


def _weighted(at: Linearisation, weight: Tensor, wanted: Tensor, rows: int) -> tuple[Tensor, Tensor, Tensor]:
    """Return sqrt(W) J, Y and r, rows in blocks: (b, rows n, .), (b, rows n, k), (b, rows n)."""
    n_blocks = len(at.J)

    def blocked(values: Tensor) -> Tensor:
        missing = n_blocks * rows - len(values)
        padded = torch.cat((values, values.new_zeros(missing, *values.shape[1:])))
        return padded.unflatten(0, (n_blocks, rows)).flatten(1, 2)

    return (
        at.J * blocked(weight).unsqueeze(-1),
        blocked(at.Y[..., wanted] * weight.unsqueeze(-1)),
        blocked(at.residual * weight),
    )


def _padded(values: Tensor, block: int, n_blocks: int) -> Tensor:
    """Return coefficients' values (K, n) as block rows (n_blocks, block n), zero beyond K."""
    missing = n_blocks * block - len(values)
    return torch.cat((values, values.new_zeros(missing, values.shape[1]))).reshape(n_blocks, -1)


def _blocks(gram: Tensor, block: int, n_blocks: int) -> tuple[Tensor, Tensor]:
    """Return the blocks (n_blocks, block, block) of B'B and those below them, zero beyond its end."""
    size = n_blocks * block
    whole = gram.new_zeros(size, size)
    whole[: len(gram), : len(gram)] = gram
    parts = whole.unflatten(0, (n_blocks, block)).unflatten(2, (n_blocks, block)).transpose(1, 2)
    at = torch.arange(n_blocks)
    return parts[at, at], parts[at[1:], at[:-1]]


def _velocity_variance(covariance: Tensor, n: int, block: int, spacing: float) -> Tensor:
    """Return the median over the knots of var(qd) (n,), with qd = (c_i+1 - c_i-1) / 2 h there."""
    own = covariance.unflatten(2, (2 * block, n)).unflatten(1, (2 * block, n)).diagonal(dim1=2, dim2=4)
    before, after = torch.arange(block), torch.arange(block) + 2
    variance = own[:, before, before] + own[:, after, after] - 2 * own[:, before, after]
    return variance.flatten(0, 1).median(0).values / (2 * spacing) ** 2


def _wander(gram: tuple[Tensor, Tensor], covariance: Tensor, n: int, block: int) -> Tensor:
    """Return tr(B'B cov(c_i)) of each joint i (n,)."""
    windows = covariance.unflatten(2, (2, block, n)).unflatten(1, (2, block, n))
    own = windows.diagonal(dim1=3, dim2=6)
    first = torch.einsum("bkl,bkli->i", gram[0][:-1], own[:, 0, :, 0])
    last = torch.einsum("kl,kli->i", gram[0][-1], own[-1, 1, :, 1])
    return first + last + 2 * torch.einsum("bkl,bkli->i", gram[1], own[:, 1, :, 0])
