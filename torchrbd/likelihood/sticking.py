"""While a joint sticks its friction is not told by motion: it is whatever holds, up to the Coulomb level.

The sign of a velocity that is too small to have one says nothing of the friction, so that the torque of such samples
says little of anything else. Their variance is that of the torque's noise and what friction may be beside it:

    var_j = sigma_j^2 (1 + (m r_j u_j)^2),   r_j = c_j / sigma_j,   u_j = low-pass of 1 - |tanh(qd_j / (4 v_j))|

with c_j the Coulomb level, v_j the rest width and u_j between 0, in motion, and 1, at rest. All samples of one stick
share one unknown friction, and together say no more than one of them: m^2 is the number of samples of a long stick.
"""

from __future__ import annotations

import torch
from torch import Tensor

# A joint that moves faster than some of these rest widths slides; below, encoders and filters hide short sticks.
_CREEP_IN_REST_WIDTHS = 4.0
_SAMPLES_OF_A_STICK = 100.0


def undetermined(qd: Tensor, rest_width: Tensor) -> Tensor:
    """Return which part of the Coulomb level the motion does not tell, between 0 (sliding) and 1 (at rest).

    Args:
        qd: (n_dof, N) [rad/s, m/s].
        rest_width: (n_dof,) speed below which the direction of motion is not told.
    """
    return 1.0 - torch.tanh(qd.abs() / (_CREEP_IN_REST_WIDTHS * rest_width.unsqueeze(-1)))


def stick_weight(unknown: Tensor, level: Tensor) -> Tensor:
    """Return the weight of samples, sigma_j^2 / var_j, (n_dof, M) between 0 and 1.

    Args:
        unknown: (n_dof, M) what ``undetermined`` returns, behind the filter that the torque has passed.
        level: (n_dof,) r_j, Coulomb friction in standard deviations of the torque's noise.
    """
    return 1.0 / (1.0 + _SAMPLES_OF_A_STICK * (level.unsqueeze(-1) * unknown) ** 2)
