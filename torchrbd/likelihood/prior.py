"""How large coefficients are believed to be before the data.

Inertial parameters: around the URDF, in the metric of pseudo-inertias, so that a body's mass, centre and inertia move
together as those of matter do; how far URDFs err is one number for a robot, learnt by evidence.

Anything else: by its own physical unit where that is known (a delay of some hundredths of a second), or by its torque
against that of its joint. Of what size it is nobody knows: sizes from hundredths to all of the joint's torque are
equally likely in the logarithm (a scale mixture), so that small effects do not pay for large ones.
"""

from __future__ import annotations

import numpy as np
import torch

from torchrbd.inference.data.columns import Candidate
from torchrbd.inference.physical.prior import divergence_hessian, in_proportion
from torchrbd.parameters import PARAMETERS_PER_BODY, nearest_physical
from torchrbd.robot import RobotModel, pseudo_inertia

# Parts of a joint's torque, and of what a physical unit's prior says.
TORQUE_SCALES = (0.02, 0.06, 0.2, 0.6)
UNIT_SCALES = (0.03, 0.1, 0.3, 1.0)


def inertial_scale(robot: RobotModel, held: frozenset[str] = frozenset()) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the prior of the inertial parameters for bodies whose log-Cholesky coordinates err by one.

    Args:
        robot: the robot.
        held: bodies whose inertia is not re-fitted; those without mass never are.

    Returns:
        mean (n_params,), indices (P,) of the fitted ones, and a root S (P, P) of their covariance S S'.
    """
    pi = robot.pi.reshape(-1, PARAMETERS_PER_BODY).clone()
    bodies = [b for b, name in enumerate(robot.body_names) if float(pi[b, 0]) > 0 and name not in held]
    fitted = nearest_physical(pi[bodies])
    pi[bodies] = fitted
    # The metric's entries differ by powers of the body's size, in units of which it is factored.
    M = divergence_hessian(torch.linalg.inv(pseudo_inertia(fitted)))
    size = M.diagonal(dim1=-2, dim2=-1).rsqrt()
    balanced = torch.linalg.cholesky(size[:, :, None] * M * size[:, None, :])
    roots = size[:, :, None] * torch.linalg.inv(balanced).mT
    index = np.concatenate([np.arange(PARAMETERS_PER_BODY) + PARAMETERS_PER_BODY * b for b in bodies] or [np.zeros(0)])
    scale = torch.block_diag(*roots).numpy() if bodies else np.zeros((0, 0))
    return pi.flatten().numpy(), index.astype(int), scale


def coefficient_std(
    candidate: Candidate, features: np.ndarray, torque_rms: np.ndarray
) -> tuple[np.ndarray, tuple[float, ...]]:
    """Return prior standard deviations of a candidate's coefficients (K,), and the multiples that are equally likely.

    Args:
        candidate: the effect at its place.
        features: (K, M) at its joint, or (K, n, M) at all.
        torque_rms: (n,) of the measured torque [N m or N].
    """
    size = np.sqrt(np.mean(features**2, axis=-1)).reshape(len(features), -1)
    own = torque_rms if candidate.place is None else torque_rms[[candidate.place]]
    ratio = (size[:, own > 0] / own[own > 0]).max(1, initial=0.0)
    by_torque = np.where(ratio > 0, 1.0 / np.maximum(ratio, 1e-300), 0.0)
    believed = np.array(candidate.effect.prior.std)
    if len(believed) != len(by_torque):
        return by_torque, TORQUE_SCALES
    if len(believed) > 1:
        return in_proportion(by_torque, believed), TORQUE_SCALES
    return np.where(by_torque > 0, believed, 0.0), UNIT_SCALES
