"""Friction while a joint sticks: it is any torque up to the Coulomb level, so motion does not determine it.

The sign of a velocity near zero does not determine the friction, so the torque of such samples has little information
about anything else. Their variance is that of the torque's noise plus that of the unknown friction:

    var_j = sigma_j^2 (1 + (m r_j u_j)^2),   r_j = c_j / sigma_j,   u_j = low-pass of 1 - |tanh(qd_j / (4 v_j))|

with c_j the Coulomb level, v_j the rest width and u_j between 0, in motion, and 1, at rest. All samples of one stick
share one unknown friction, so together they have no more information than one of them: m^2 is the number of samples of
a long stick.
"""

from __future__ import annotations

import torch
from torch import Tensor

# A joint slides above this multiple of its rest width; below, encoders and filters hide short sticks.
_CREEP_IN_REST_WIDTHS = 4.0
_SAMPLES_OF_A_STICK = 100.0


def undetermined(qd: Tensor, rest_width: Tensor) -> Tensor:
    """Return the share of the Coulomb level that the motion does not determine, from 0 (sliding) to 1 (at rest).

    Args:
        qd: (n_dof, N) [rad/s, m/s].
        rest_width: (n_dof,) speed below which the direction of motion is uncertain.
    """
    return 1.0 - torch.tanh(qd.abs() / (_CREEP_IN_REST_WIDTHS * rest_width.unsqueeze(-1)))


def stick_weight(unknown: Tensor, level: Tensor) -> Tensor:
    """Return the weight of samples, sigma_j^2 / var_j, (n_dof, M) between 0 and 1.

    Args:
        unknown: (n_dof, M) result of ``undetermined``, through the same filter as the torque.
        level: (n_dof,) r_j, Coulomb friction in standard deviations of the torque's noise.
    """
    return 1.0 / (1.0 + _SAMPLES_OF_A_STICK * (level.unsqueeze(-1) * unknown) ** 2)
