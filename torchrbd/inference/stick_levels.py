"""How much dry friction each joint has against the noise of its torque: what a joint that sticks may hide.

A joint that never moves does not show its friction, which may hold a part of the load all the same: such a torque
follows the load by less than all of it, as if its gain erred.
"""

from __future__ import annotations

import torch
from torch import Tensor

from torchrbd.dataset.block_statistics import BlockStatistics
from torchrbd.inference.physical.fitting import fit_model
from torchrbd.likelihood.urdf_prior import Prior

# Friction that a first fit is not sure of is none.
_SURE = 3.0
# Friction of a joint that never moves, in parts of its torque: what gears have.
_HELD = 0.1
# Sticks and effects that nobody has named yet spoil some blocks; the better ones show the noise.
_QUIET_PART = 0.25


def stick_levels(training: BlockStatistics, prior: Prior) -> Tensor:
    """Return Coulomb friction over the standard deviation of the torque's noise, (n_dof,); 0 where there is none.

    Both are from a fit of the rigid body with viscous and Coulomb friction at all joints that move. Of the others the
    friction is assumed.

    Args:
        training: blocks to fit, all samples with their full weight.
        prior: prior of the inertial parameters.
    """
    columns = training.columns
    terms = [c for c in columns.urdf_friction if columns.scale(c.site).moves]
    fitted = fit_model(training, prior, terms)
    weight, _, squares = training.torque.unbind(-1)
    error = training.squared_error(fitted.x)
    levels = torch.zeros(columns.robot.n_dof, dtype=torch.float64)
    for c in columns.urdf_friction:
        j = c.joint
        seen = weight[:, j] > 0
        if c.effect.urdf_tag != "friction" or not seen.any():
            continue
        if c in terms:
            (coulomb,), ((variance,),) = fitted.coefficients(c)
            coulomb = coulomb if coulomb > _SURE * variance.sqrt() else torch.zeros_like(coulomb)
        else:
            coulomb = _HELD * (squares[:, j].sum() / weight[:, j].sum()).sqrt()
        noise = (error[seen, j] / weight[seen, j]).quantile(_QUIET_PART).sqrt()
        levels[j] = coulomb / noise.clamp_min(1e-300)
    return levels
