"""How much dry friction each joint has against the noise of its torque: what a joint that sticks may hide."""

from __future__ import annotations

import torch
from torch import Tensor

from torchrbd.inference.data.block_statistics import BlockStatistics
from torchrbd.inference.physical.fitting import fit_model
from torchrbd.inference.physical.prior import Prior

# Friction that a first fit is not sure of is none.
_SURE = 3.0
# A joint moves if it reaches so many times the speed below which its direction is not told.
_MOVES = 3.0
# Sticks and effects that nobody has named yet spoil some blocks; the better ones show the noise.
_QUIET_PART = 0.25


def stick_levels(training: BlockStatistics, prior: Prior) -> Tensor:
    """Return Coulomb friction over the standard deviation of the torque's noise, (n_dof,); 0 where there is none.

    Both are from a fit of the rigid body with viscous and Coulomb friction at all joints that move.

    Args:
        training: blocks to fit, all samples with their full weight.
        prior: prior of the inertial parameters.
    """
    columns = training.columns
    moving = [s.speed_max > _MOVES * s.rest_width for s in columns.scales]
    terms = [c for c in columns.urdf_friction if moving[c.joint]]
    levels = torch.zeros(columns.robot.n_dof, dtype=torch.float64)
    if not terms:
        return levels
    fitted = fit_model(training, prior, terms)
    weight, error = training.torque[..., 0], training.squared_error(fitted.x)
    for term in terms:
        seen = weight[:, term.joint] > 0
        if term.effect.id != "coulomb_friction" or not seen.any():
            continue
        (coulomb,), ((variance,),) = fitted.coefficients(term)
        noise = (error[seen, term.joint] / weight[seen, term.joint]).quantile(_QUIET_PART).sqrt()
        if coulomb > _SURE * variance.sqrt():
            levels[term.joint] = coulomb / noise.clamp_min(1e-300)
    return levels
