"""Baseline friction of each joint, a part of the torque that the actuator supplies:

    viscous qd + coulomb sign(qd) + offset

Effects of sensors and actuators act on this torque too, not only on that of the rigid body. Only effects that are
linear in these three coefficients count; none of them depends on friction itself.
"""

from __future__ import annotations

from collections.abc import Iterable

import torch
from torch import Tensor

_COULOMB_AND_MORE = ((0.0, 1.0, 0.0), (0.0, 0.0, 0.0))
# By effect: what each of its coefficients adds to (viscous, coulomb, offset).
PARTS: dict[str, tuple[tuple[float, float, float], ...]] = {
    "viscous_friction": ((1.0, 0.0, 0.0),),
    "coulomb_friction": ((0.0, 1.0, 0.0),),
    "torque_offset": ((0.0, 0.0, 1.0),),
    "asymmetric_coulomb_friction": ((0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
    # These contain Coulomb friction and replace it.
    "stribeck_friction": _COULOMB_AND_MORE,
    "time_varying_friction": _COULOMB_AND_MORE,
    "position_dependent_friction": _COULOMB_AND_MORE,
}


def plain_friction(n_dof: int, terms: Iterable[tuple[str, int | None, Tensor]]) -> Tensor:
    """Return the sums of viscous and Coulomb coefficients and offsets of each joint, (n_dof, 3), differentiable in w.

    Args:
        n_dof: number of joints.
        terms: effect id, joint and coefficients w (K,) of each; effects that are not in ``PARTS`` are ignored.
    """
    total = torch.zeros(n_dof, 3, dtype=torch.float64)
    for effect, joint, w in terms:
        if effect in PARTS and joint is not None:
            parts = torch.tensor(PARTS[effect], dtype=total.dtype, device=w.device)
            total = total.to(w.device).index_add(0, torch.tensor([joint], device=w.device), (w.to(parts) @ parts)[None])
    return total
