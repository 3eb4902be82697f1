"""Block statistics of states given sample by sample: without recording, filter or clock."""

from __future__ import annotations

import torch
from torch import Tensor

from torchrbd.dataset.block_statistics import Block, BlockStatistics
from torchrbd.dataset.columns import Columns

# Enough to measure the scatter of neighbouring samples.
_MOST_BLOCKS = 64
_ROWS_AT_ONCE = 4096


def given_statistics(columns: Columns, states: Tensor, tau: Tensor, weight: Tensor) -> BlockStatistics:
    """Return the moments of samples in blocks of neighbours.

    Args:
        columns: the layout of x, without effects that need a sequence.
        states: (3, n_dof, N) q, qd and qdd, [rad, m] and per second, per second squared.
        tau: (n_dof, N) [N m, N].
        weight: (n_dof, N) number of independent samples that each counts as.
    """
    n_samples = tau.shape[1]
    blocks = torch.arange(n_samples).tensor_split(min(_MOST_BLOCKS, n_samples))
    moments, torque = [], []
    for block in blocks:
        tiles = [_moments(columns, states[..., k], tau[:, k], weight[:, k]) for k in block.split(_ROWS_AT_ONCE)]
        moments.append([sum(parts[1:], parts[0]) for parts in zip(*tiles, strict=True)])
        w, own = weight[:, block], tau[:, block]
        torque.append(torch.stack((w.sum(1), (w * own).sum(1), (w * own.square()).sum(1)), -1))
    return BlockStatistics(
        columns=columns,
        blocks=tuple(Block("samples", float(block[0]), float(block[-1])) for block in blocks),
        moments=tuple(torch.stack(own) for own in zip(*moments, strict=True)),
        torque=torch.stack(torque),
    )


def _moments(columns: Columns, states: Tensor, tau: Tensor, weight: Tensor) -> list[Tensor]:
    """Return per joint the moments (p_j + 1, p_j + 1) of its rows [Y_j, phi_j, tau_j]."""
    q, qd, qdd = states
    Y, features = columns.robot.regressor_batch_last(q, qd, qdd), columns.features_of(columns.signals_at(q, qd, qdd))
    rows = (torch.cat((Y[j, columns.inertial[j]], features[j], tau[j : j + 1])) for j in range(len(tau)))
    return [(a * w) @ a.T for a, w in zip(rows, weight, strict=True)]
