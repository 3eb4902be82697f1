"""How uncertain a fitted model's torque is.

var tau_j = a_j cov(x) a_j' + sigma_j^2,   a_j = [Y_j, phi_j]
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from torchrbd.inference.physical.fitting import FittedModel

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
    for at in zip(*(v.T.split(_CHUNK, 1) for v in (q, qd, qdd)), strict=True):
        rows = torque_rows(model, *at)
        found.append(torch.stack([torch.einsum("kn,kl,ln->n", a, cov[k.unsqueeze(1), k], a) for k, a in rows], -1))
    variance = torch.cat(found) if found else q.new_zeros(0, robot.n_dof)
    return PredictiveVariance(variance.reshape(*batch, robot.n_dof), model.noise_variance)


def torque_rows(model: FittedModel, q: Tensor, qd: Tensor, qdd: Tensor) -> list[tuple[Tensor, Tensor]]:
    """Return what multiplies the coefficients in each joint's torque.

    Args:
        model: the fit; of its features those of fitted terms count, without those that need a sequence.
        q, qd, qdd: (n_dof, N).

    Returns:
        Per joint indices in x (K,), and a_j = [Y_j, phi_j] (K, N).
    """
    columns = model.columns
    Y = columns.robot.regressor_batch_last(q, qd, qdd)
    features = columns.evaluated(columns.signals_at(q, qd, qdd), model.terms)
    found = []
    for joint, (inertial, all_own) in enumerate(zip(columns.inertial, columns.of_joint, strict=True)):
        there = features.keys() & set(all_own.tolist())
        own = {k: v if v.ndim == 1 else v[joint] for k, v in features.items() if k in there}
        index = torch.cat((inertial, torch.tensor(list(own)).long()))
        found.append((index, torch.cat((Y[joint, inertial], *(v.unsqueeze(0) for v in own.values())))))
    return found
