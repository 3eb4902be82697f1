"""Joints at rest: the noise of their velocity is not motion and has no information about friction.

    E[phi phi'] = phi0 phi0' + noise

A joint is at rest in a block of time if the root mean square of its velocity is below the speed at which its direction
is known. The columns of its own motion, d qd or c sign(qd), are then noise, and phi0 is zero. The block therefore has
none of these columns. Otherwise they would pull friction to zero, or to whatever a drive makes of the noise.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from torchrbd.dataset.block_statistics import BlockStatistics


def at_rest(statistics: BlockStatistics) -> Tensor:
    """Return in which blocks joints are at rest, (B, n_dof) bool; False without torque."""
    columns, weight = statistics.columns, statistics.torque[..., 0]
    rest = torch.zeros_like(weight, dtype=torch.bool)
    for joint, (moments, slow) in enumerate(zip(statistics.moments, columns.slow.tolist(), strict=True)):
        k = columns.local(joint, "qd")
        rest[:, joint] = moments[:, k, k] < slow**2 * weight[:, joint]
    return rest


def moving(qd: np.ndarray, block: np.ndarray, slow: np.ndarray) -> np.ndarray:
    """Return which joints move in at least one block, (n,) bool.

    Args:
        qd: (n, M) [rad/s, m/s].
        block: (M,) number of each row's block.
        slow: (n,) speeds below which a joint's direction is uncertain [rad/s, m/s].
    """
    rows = np.maximum(np.bincount(block), 1)
    power = np.stack([np.bincount(block, one**2) for one in qd]) / rows
    return np.any(power >= slow[:, None] ** 2, axis=1)


def without_columns_at_rest(statistics: BlockStatistics) -> BlockStatistics:
    """Return the statistics without the columns of a joint's own motion in blocks in which it is at rest."""
    rest = at_rest(statistics)
    moments = list(statistics.moments)
    for joint in torch.nonzero(rest.any(0)).flatten().tolist():
        made = statistics.columns.made_by_motion(joint)
        kept = torch.where(rest[:, joint, None] & made, 0.0, 1.0)
        kept = torch.cat((kept, torch.ones(len(rest), 1, dtype=torch.float64)), 1)
        moments[joint] = moments[joint] * kept.unsqueeze(2) * kept.unsqueeze(1)
    return replace(statistics, moments=tuple(moments))
