"""Small identification problems, and their dense counterparts in plain numpy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from robot.random_robots import random_urdf
from simulated import record
from torch import Tensor

from torchrbd.dataset.block_statistics import Block, BlockStatistics, block_statistics
from torchrbd.dataset.columns import Columns
from torchrbd.effects import JointScale, effect
from torchrbd.likelihood.urdf_prior import Prior, urdf_prior
from torchrbd.recordings import Filtering, Recording, States, survey, tiles
from torchrbd.robot import RobotModel

KINDS = ("revolute", "prismatic")
EFFECTS = ("viscous_friction", "coulomb_friction", "rotor_inertia", "joint_spring")
LABELS = ("qd", "sign(qd)", "qdd", "q", "1")
REST_WIDTH = 0.05
FILTERING = Filtering(5.0)


def urdf_of(seed: int, n_joints: int, **options: float) -> str:
    """Return a random robot that Pinocchio reads with one coordinate a joint, every body with mass."""
    return random_urdf(seed, n_joints, kinds=KINDS, **{"massless": 0.0, **options})


def columns_of(robot: RobotModel, effects: Sequence[str] = EFFECTS) -> Columns:
    scale = JointScale(3.0, REST_WIDTH)
    return Columns(robot, [effect(name) for name in effects], [scale] * robot.n_dof)


def stream(recording: Recording, rows: int = 4096) -> list[States]:
    return list(tiles(recording, survey(recording), FILTERING, rows))


def statistics_of(columns: Columns, recording: Recording, *, rows: int = 4096, block_s: float = 1.5) -> BlockStatistics:
    measured = torch.as_tensor(recording.measured)
    rate = FILTERING.effective_rate
    streamed = iter(stream(recording, rows))
    return block_statistics(columns, recording.name, streamed, measured, block_s=block_s, independent_rate_hz=rate)


@dataclass(frozen=True)
class Dense:
    """Band-limited rows: t (M,); A (n_dof, M, n) over the whole of x; tau (n_dof, M); weight of a sample."""

    t: np.ndarray
    A: np.ndarray
    tau: np.ndarray
    weight: float


def dense(columns: Columns, recording: Recording) -> Dense:
    """Compute every column at the full rate, by its equation, and filter it by itself."""
    (states,) = stream(recording, 10**7)
    robot = columns.robot
    A = np.zeros((robot.n_dof, len(states.t_out), columns.n))
    Y = robot.regressor(states.q.T, states.qd.T, states.qdd.T)
    for j in range(robot.n_dof):
        for k in range(robot.n_params):
            A[j, :, k] = states.decimate(Y[:, j, k]).numpy()
        q, qd, qdd = states.q[j], states.qd[j], states.qdd[j]
        phi = {"qd": qd, "sign(qd)": torch.tanh(qd / REST_WIDTH), "qdd": qdd, "q": q, "1": torch.ones_like(q)}
        for label in columns.labels[j]:
            A[j, :, columns.index(j, label)] = states.decimate(phi[label]).numpy()
    tau = torch.stack([states.decimate(x) for x in states.tau]).numpy()
    return Dense(states.t_out.numpy(), A, tau, FILTERING.effective_rate * states.dt_out)


def recorded(seed: int, n_joints: int = 3, **options) -> tuple[RobotModel, Recording]:
    urdf = urdf_of(seed, n_joints)
    return RobotModel.from_urdf(urdf), record(urdf, seed, **{"duration_s": 15.0, **options})


def random_moments(columns: Columns, seed: int, samples: int, torque: float | Tensor = 1.0) -> BlockStatistics:
    """Make one block from random states; torque is white of that size, or that of given coefficients x (n,)."""
    robot, generator = columns.robot, torch.Generator().manual_seed(seed)

    def draw(*shape: int) -> Tensor:
        return torch.randn(*shape, generator=generator, dtype=torch.float64)

    Y = robot.regressor(2 * draw(samples, robot.n_dof), 2 * draw(samples, robot.n_dof), 2 * draw(samples, robot.n_dof))
    moments, torques = [], []
    for j, own in enumerate(columns.of_joint):
        n_rigid = len(columns.inertial[j])
        a = torch.cat((Y[:, j, own[:n_rigid]], draw(samples, len(own) - n_rigid)), 1)
        tau = a @ torque[own] if isinstance(torque, Tensor) else torque * draw(samples)
        a = torch.cat((a, tau[:, None]), 1)
        moments.append((a.T @ a)[None])
        torques.append(torch.stack((torch.tensor(float(samples)), tau.sum(), tau.square().sum())))
    return BlockStatistics(columns, (Block("random", 0.0, 1.0),), tuple(moments), torch.stack(torques)[None].double())


def prior_of(columns: Columns, kappa: float = 3.0, held: tuple[str, ...] = ()) -> Prior:
    n = columns.robot.n_dof
    ones = torch.ones(n, dtype=torch.float64), torch.ones(n, columns.n, dtype=torch.float64)
    return urdf_prior(columns, *ones, held=held, kappa=kappa)
