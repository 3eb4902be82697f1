"""The prior size of coefficients.

Inertial parameters: around the URDF, in the metric of pseudo-inertias, so a body's mass, centre and inertia vary
together as those of matter do. The error of the URDF is one number per robot, learnt by evidence.

All others: by their own physical unit if a typical size is known (a delay of some hundredths of a second, a joint that
is off by some centimetres), or by their torque relative to that of the joint. That size is unknown: sizes from
hundredths to all of the joint's torque are equally probable in the logarithm (a scale mixture). So small effects are
not penalised by a prior for large ones.
"""

from __future__ import annotations

import numpy as np
import torch

from torchrbd.dataset.columns import Candidate
from torchrbd.likelihood.urdf_prior import in_proportion, orthonormal_steps
from torchrbd.parameters import PARAMETERS_PER_BODY, nearest_physical, thickened
from torchrbd.robot import RobotModel, pseudo_inertia

# Fractions of a joint's torque, or of the size that the prior has in a physical unit.
TORQUE_SCALES = (0.02, 0.06, 0.2, 0.6)
UNIT_SCALES = (0.03, 0.1, 0.3, 1.0, 3.0)


def inertial_scale(robot: RobotModel, held: frozenset[str] = frozenset()) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the coordinates of the inertial parameters: pi = mean + S z / sqrt(kappa), see ``physical.py``.

    Args:
        robot: the robot.
        held: bodies whose inertia is not fitted; those without mass never are.

    Returns:
        mean (n_params,), indices (P,) of the fitted ones, and S (P, P).
    """
    pi = robot.pi.reshape(-1, PARAMETERS_PER_BODY).clone()
    bodies = [b for b, name in enumerate(robot.body_names) if float(pi[b, 0]) > 0 and name not in held]
    pi[bodies] = thickened(nearest_physical(pi[bodies]))
    scale = torch.block_diag(*orthonormal_steps(torch.linalg.cholesky(pseudo_inertia(pi[bodies]))), pi.new_zeros(0, 0))
    index = [PARAMETERS_PER_BODY * b + k for b in bodies for k in range(PARAMETERS_PER_BODY)]
    return pi.flatten().numpy(), np.array(index, dtype=int), scale.numpy()


def coefficient_std(
    candidate: Candidate, rms: np.ndarray, torque_rms: np.ndarray
) -> tuple[np.ndarray, tuple[float, ...]]:
    """Return prior standard deviations of a candidate's coefficients (K,), and the multiples with equal probability.

    Args:
        candidate: the effect at its place.
        rms: (K,) of its features at its joint, or (K, n) at all.
        torque_rms: (n,) of the measured torque [N m or N].
    """
    size = rms.reshape(len(rms), -1)
    own = torque_rms if candidate.place is None else torque_rms[[candidate.place]]
    ratio = (size[:, own > 0] / own[own > 0]).max(1, initial=0.0)
    by_torque = np.where(ratio > 0, 1.0 / np.maximum(ratio, 1e-300), 0.0)
    believed = np.array(candidate.effect.prior.std)
    if len(believed) != len(by_torque):
        return by_torque, TORQUE_SCALES
    if candidate.effect.prior.of_any_size:
        return in_proportion(by_torque, believed), TORQUE_SCALES
    return np.where(by_torque > 0, believed, 0.0), UNIT_SCALES
