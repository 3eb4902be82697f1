"""Torques of effects at one joint, and what is left of them."""

from __future__ import annotations

import numpy as np
import pinocchio
import torch
from effects.sites import ROBOT, signals, states

from torchrbd.effects import Effect, Signals, Site, Term

Values = np.ndarray
SHARP = 1e-4
"""Rest width [rad/s] at which the sign of the velocities below is +-1."""
Q, QD = np.array([-1.2, -0.3, 0.2, 0.9, 1.4]), np.array([0.7, -1.1, 2.0, -0.4, 1.5])


def term(effect: Effect, site: Site, parameters: dict[str, float]) -> Term:
    w, shape = effect.coefficients(parameters)
    return Term(effect, site, torch.tensor(w, dtype=torch.float64), shape)


def torque(effect: Effect, q: Values = Q, qd: Values = QD, **parameters: float) -> Values:
    """Return the torque of an effect at joint 0, whose position and velocity are given; time runs in steps of 10 ms."""
    x = (torch.tensor(v, dtype=torch.float64).expand(ROBOT.n_dof, -1) for v in (q, qd, 0.0 * qd))
    return term(effect, Site(0), parameters)(signals(*x, rest_width=SHARP)).detach().numpy()


def loaded(seed: int = 3, n: int = 200) -> tuple[Signals, Values]:
    """Return signals of a robot in motion, and its torque by Pinocchio (n_dof, n)."""
    x = states(n, seed=seed)
    model = pinocchio.buildModelFromXML(ROBOT.urdf)
    data, order = model.createData(), [model.getJointId(name) - 1 for name in ROBOT.joint_names]
    tau = np.zeros((ROBOT.n_dof, n))
    for k in range(n):
        state = np.zeros((3, model.nv))
        state[:, order] = np.stack([v[:, k].numpy() for v in x])
        tau[:, k] = pinocchio.rnea(model, data, *state)[order]
    return signals(*x, rest_width=SHARP), tau


def rest(tau: Values, X: Values) -> Values:
    """Return what least squares with columns X (N, K) leaves of tau (N,)."""
    U, S, _ = np.linalg.svd(X, full_matrices=False)
    U = U[:, S / S[0] > 1e-10]
    return tau - U @ (U.T @ tau)
