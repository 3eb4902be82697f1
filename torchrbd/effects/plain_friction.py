"""Baseline friction of each joint, a part of the torque that the actuator supplies:

    viscous qd + coulomb sign(qd) + offset

Effects of sensors and actuators act on this torque too, not only on that of the rigid body. Only effects that are
linear in these three coefficients count; none of them depends on friction itself.
"""

from __future__ import annotations

from collections.abc import Iterable

import torch
from torch import Tensor

from torchrbd.effects.base import Effect


def plain_friction(n_dof: int, terms: Iterable[tuple[Effect, int | None, Tensor]]) -> Tensor:
    """Return the sums of viscous and Coulomb coefficients and offsets of each joint, (n_dof, 3), differentiable in w.

    Args:
        n_dof: number of joints.
        terms: effect, joint and coefficients w (K,) of each; see ``Effect.baseline``.
    """
    total = torch.zeros(n_dof, 3, dtype=torch.float64)
    for effect, joint, w in terms:
        if effect.baseline and joint is not None:
            parts = torch.tensor(effect.baseline, dtype=total.dtype, device=w.device)
            total = total.to(w.device).index_add(0, torch.tensor([joint], device=w.device), (w.to(parts) @ parts)[None])
    return total
