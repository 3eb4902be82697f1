"""How uncertain a fitted model's torque is.

var tau_j = a_j cov(x) a_j' + sigma_j^2,   a_j = [Y_j, phi_j]
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from torchrbd.inference.physical.fitting import FittedModel
from torchrbd.physics import JointState

_CHUNK = 2048


@dataclass(frozen=True)
class PredictiveVariance:
    """Variance of a predicted torque, [(N m)^2] or [N^2].

    Attributes:
        parameters: (*batch, n_dof) Y cov Y', from what is not known of the coefficients.
        noise: (n_dof,) of the band-limited torque that the model does not explain; inf without recorded torque.
    """

    parameters: Tensor
    noise: Tensor


def predictive_variance(model: FittedModel, q: Tensor, qd: Tensor, qdd: Tensor) -> PredictiveVariance:
    """Return the two parts of the variance of a predicted torque, that of the parameters and that of the noise.

    Args:
        model: the fit; its ``covariance`` counts.
        q, qd, qdd: (*batch, n_dof) [rad or m, per s, per s^2].
    """
    robot, columns = model.columns.robot, model.columns
    batch = q.shape[:-1]
    q, qd, qdd = (v.reshape(-1, robot.n_dof).to(torch.float64) for v in (q, qd, qdd))
    cov = torch.zeros(columns.n, columns.n, dtype=torch.float64)
    cov[model.free.unsqueeze(1), model.free] = model.covariance
    found = []
    for at in zip(*(v.split(_CHUNK) for v in (q, qd, qdd)), strict=True):
        Y = robot.regressor_batch_last(*(v.T for v in at))
        rows = []
        for joint in range(robot.n_dof):
            index, a = joint_rows(model, joint, Y[joint], *(v[:, joint] for v in at))
            rows.append(torch.einsum("kn,kl,ln->n", a, cov[index.unsqueeze(1), index], a))
        found.append(torch.stack(rows, -1))
    variance = torch.cat(found) if found else q.new_zeros(0, robot.n_dof)
    return PredictiveVariance(variance.reshape(*batch, robot.n_dof), model.noise_variance)


def joint_rows(model: FittedModel, joint: int, Y: Tensor, q: Tensor, qd: Tensor, qdd: Tensor) -> tuple[Tensor, Tensor]:
    """Return what multiplies the coefficients in one joint's torque.

    Args:
        model: the fit; of its features those of fitted terms count.
        joint: index of the joint.
        Y: (n_params, N) its regressor.
        q, qd, qdd: (N,) its own states.

    Returns:
        indices in x (K,), and a_j = [Y_j, phi_j] (K, N).
    """
    columns = model.columns
    state = JointState(q, qd, qdd, columns.scales[joint].rest_width)
    features: dict[int, Tensor] = {}
    for candidate in model.terms:
        if candidate.joint == joint:
            found = candidate.effect.features(state, candidate.shape)
            features.update({columns.index(joint, label): value for label, value in found.items()})
    index = torch.cat((columns.inertial[joint], torch.tensor(list(features), dtype=torch.long)))
    return index, torch.cat((Y[columns.inertial[joint]], *(v.unsqueeze(0) for v in features.values())))
