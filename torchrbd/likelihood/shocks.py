"""Shocks: where a joint's acceleration leaves its course for less than a tenth of a second or so.

A motor that crosses the play of its gear, or a link that hits something, jumps, and the positions that are recorded
are then not those of the bodies that the torque moves. Such samples have the largest accelerations of all: a few of
them draw the inertial parameters of the whole recording with them. A joint's shock at a sample is

    s_j(t) = max |qdd_j(t') - running median of qdd_j over W around t'|,   |t' - t| < D

which takes a long step of the acceleration for no shock.
"""

from __future__ import annotations

import torch
from scipy.ndimage import maximum_filter1d, median_filter
from torch import Tensor

# W, and D on both sides [s].
_COURSE_S, _BESIDE_S = 0.3, 0.1
# An output that sees more of shocks than this, through the filter that the torque passes, sees them.
_SEES = 0.05


def shock(qdd: Tensor, dt: float) -> Tensor:
    """Return how far accelerations leave their course, (n_dof, N) [rad/s^2, m/s^2].

    Args:
        qdd: (n_dof, N) at intervals dt [s].
    """
    course = median_filter(qdd.numpy(), size=(1, 2 * round(0.5 * _COURSE_S / dt) + 1), mode="nearest")
    jump = abs(qdd.numpy() - course)
    return torch.from_numpy(maximum_filter1d(jump, 2 * round(_BESIDE_S / dt) + 1, axis=-1, mode="nearest"))


def calm(shocked: Tensor) -> Tensor:
    """Return the weight of samples, (M,) 0 or 1.

    Args:
        shocked: (M,) whether a joint has a shock, behind the filter that the torque has passed.
    """
    return (shocked.abs() < _SEES).to(shocked)
