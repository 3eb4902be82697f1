"""A small arm whose recordings hold a torque that its model does not know, and samples of it without noise."""

from __future__ import annotations

from functools import cache

import numpy as np
import torch
from robot.random_robots import random_urdf
from simulated import Motion, inverse_dynamics, multisine
from torch import Tensor

from torchrbd import RigidBodyDynamics
from torchrbd.learning import ResidualDataset, physics_columns
from torchrbd.recordings import Recording
from torchrbd.robot import RobotModel

URDF = random_urdf(4, 2, kinds=("revolute",), fixed=0.0, massless=0.0)
ROBOT = RobotModel.from_urdf(URDF)
NAMES = ROBOT.joint_names
FRICTION = ("viscous_friction", "coulomb_friction")


def physics(effects: tuple[str, ...] = FRICTION) -> RigidBodyDynamics:
    """Return the arm with terms at small values."""
    model = RigidBodyDynamics.from_urdf(URDF, effects=effects)
    with torch.no_grad():
        for k, term in enumerate(model.terms):
            term.coefficients.fill_(0.1 * (k + 1))
    return model


@cache
def recording(
    seconds: float = 40.0, seed: int = 0, name: str = "simulated", *, reference: bool = False, pace: float = 1.0
) -> Recording:
    """Record the arm with the torque 3 sin(q_1) qd_2 more at its first joint, which no term of its model has.

    Set-points lead by 0.01 s; at another pace the same motion takes less time.
    """
    slow = multisine(2, seed, duration_s=seconds * pace, rate_hz=100.0 / pace)
    motion = Motion(slow.t / pace, slow.q, pace * slow.qd, pace**2 * slow.qdd)
    tau = inverse_dynamics(URDF, motion)
    tau[:, 0] += 3.0 * np.sin(motion.q[:, 0]) * motion.qd[:, 1]
    tau += 0.02 * tau.std(0) * np.random.default_rng(seed).standard_normal(tau.shape)
    optional = {"q_ref": motion.q + 0.01 * motion.qd} if reference else {}
    return Recording.from_arrays(name, list(NAMES), motion.t, motion.q, tau, **optional)


def samples(model: RigidBodyDynamics, residual: Tensor, features: Tensor) -> ResidualDataset:
    """Return samples (N, n) of a residual without noise at features (N, 3 n)."""
    states = features.unflatten(-1, (3, ROBOT.n_dof)).unbind(-2)
    with torch.no_grad():
        torque = model(*states)
    count = torch.arange(len(features))
    return ResidualDataset(
        physics=model, features=features, residual=residual, weight=torch.ones_like(residual), physics_torque=torque,
        recordings=("made",), recording=0 * count, t=0.05 * count.double(), dt=0.05, cutoff_hz=5.0, history=0,
        noise_std=torch.ones(ROBOT.n_dof), sample=count, columns=physics_columns(model, *states),
    )  # fmt: skip


def features(count: int, seed: int = 0, dtype: torch.dtype = torch.float64) -> Tensor:
    """Return random features (count, 3 n) within an angle or so of zero."""
    return torch.randn(count, 3 * ROBOT.n_dof, dtype=dtype, generator=torch.Generator().manual_seed(seed))
