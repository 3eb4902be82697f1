"""The real head, in MuJoCo: inertials that differ from ``head.urdf``, noisy sensors, and effects that nobody knows of.

MuJoCo integrates the robot and nothing else; what the estimators see are encoder positions and motor torques.
"""

# pyright: reportAttributeAccessIssue=false
# (MuJoCo ships no type stubs)

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
import torch
from torch import Tensor

from torchrbd import Recording, RigidBodyDynamics, RobotModel, to_urdf
from torchrbd.model import described_terms
from torchrbd.parameters import PARAMETERS_PER_BODY
from torchrbd.robot import from_pseudo_inertia, pseudo_inertia

from .motion import DT, Motion

URDF = Path(__file__).with_name("head.urdf")
SPREAD = 0.15  # of a body's pseudo-inertia: mass, lever and radii of gyration are then off by about 30 %
PD_STIFFNESS = np.array([60.0, 25.0, 8.0, 0.3, 0.2, 0.3, 0.2])  # N m/rad
PD_DAMPING = np.array([5.0, 2.5, 0.6, 0.018, 0.014, 0.018, 0.014])  # N m s/rad
OBSERVER_HZ = 10.0
EFFECTS = {  # what the URDF does not hold: MuJoCo's array of it and its value at each joint
    "friction": ("dof_frictionloss", [0.20, 0.15, 0.08, 0.004, 0.003, 0.004, 0.003]),  # Coulomb, N m
    "cables": ("jnt_stiffness", [0.0, 0.0, 0.0, 0.012, 0.008, 0.012, 0.008]),  # N m/rad
}


@dataclass(frozen=True)
class Noise:
    """Sensor noise, white.

    Attributes:
        encoder: [rad].
        torque: part of each joint's torque RMS.
    """

    encoder: float = 1e-3
    torque: float = 0.05


def perturbed(robot: RobotModel, rng: np.random.Generator) -> Tensor:
    """Draw other inertial parameters (n_params,), physical ones, around a robot's.

        J = L A A' L',   J0 = L L',   A = 1 + SPREAD G,   G_kl ~ N(0, 1)

    with J the pseudo-inertia: positive definite whatever A, and the same relative change in any frame and unit.
    """
    L = torch.linalg.cholesky(pseudo_inertia(robot.pi.reshape(-1, PARAMETERS_PER_BODY)))
    A = torch.eye(4, dtype=torch.float64) + SPREAD * torch.from_numpy(rng.standard_normal(L.shape))
    return from_pseudo_inertia(L @ A @ A.mT @ L.mT).flatten()


class RealHead:
    """The robot with its true inertial parameters; any number of copies of it move at a time.

    Args:
        robot: the URDF's kinematics, viscous friction and limits, which are right.
        pi: (n_params,) true inertial parameters.
        effects: keys of ``EFFECTS`` that act on it.
    """

    def __init__(self, robot: RobotModel, pi: Tensor, effects: Iterable[str] = ()) -> None:
        self.robot, self.pi = robot, pi
        urdf = to_urdf(RigidBodyDynamics(robot, pi, described_terms(robot)))
        self.mujoco = mujoco.MjModel.from_xml_string(urdf.decode())
        self.mujoco.opt.timestep = DT
        self.mujoco.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
        # As hard as the step allows: friction is then c sign(qd) except near a reversal.
        self.mujoco.dof_solref[:] = [2 * DT, 1.0]
        self.order = [self.mujoco.joint(name).id for name in robot.joint_names]
        for effect in effects:
            array, values = EFFECTS[effect]
            getattr(self.mujoco, array)[self.order] = values
        self._effort = robot.effort.numpy()
        self._copies: list[mujoco.MjData] = []

    def start(self, q: np.ndarray, qd: np.ndarray) -> None:
        """Make as many copies as q and qd (B, n) have rows, and let them start there."""
        self._copies = [mujoco.MjData(self.mujoco) for _ in q]
        for data, position, velocity in zip(self._copies, q, qd, strict=True):
            data.qpos[self.order], data.qvel[self.order] = position, velocity

    def step(self, tau: np.ndarray, moving: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Hold torques (B, n) [N m] for one control period, within the motors' limits.

        Args:
            tau: torques.
            moving: (B,) bool; the other copies stand still.

        Returns:
            q, qd (B, n) at its end.
        """
        for data, torque, moves in zip(self._copies, np.clip(tau, -self._effort, self._effort), moving, strict=True):
            if moves:
                data.qfrc_applied[self.order] = torque
                mujoco.mj_step(self.mujoco, data)
        q, qd = np.array([(data.qpos, data.qvel) for data in self._copies]).transpose(1, 0, 2)[..., self.order]
        return q, qd


class Observer:
    """Estimate error and its rate from noisy errors: an alpha-beta filter with two equal poles at ``OBSERVER_HZ``."""

    def __init__(self, error: np.ndarray) -> None:
        pole = np.exp(-2 * np.pi * OBSERVER_HZ * DT)
        self._alpha, self._beta = 1 - pole**2, (1 - pole) ** 2
        self.error, self.rate = error, np.zeros_like(error)

    def update(self, measured: np.ndarray) -> None:
        """Take the errors (B, n) [rad] of the next control period."""
        self.error = self.error + DT * self.rate
        surprise = measured - self.error
        self.error = self.error + self._alpha * surprise
        self.rate = self.rate + self._beta / DT * surprise


def record(head: RealHead, reference: Motion, rng: np.random.Generator, noise: Noise) -> Recording:
    """Record encoders, motors and set-points while a PD controller of low gain follows a reference.

    The torque of a sample is the mean of the control periods before and after it, so that it has no delay.
    """
    head.start(reference.q[:1], reference.qd[:1])
    q, moving = reference.q[:1], np.ones(1, dtype=bool)
    jitter = noise.encoder * rng.standard_normal(reference.q.shape)
    observer = Observer(np.zeros_like(q))
    encoder, applied = np.empty_like(reference.q), np.empty_like(reference.q)
    for k, target in enumerate(reference.q):
        encoder[k] = q[0] + jitter[k]
        if k:
            observer.update(target - encoder[k : k + 1])
        tau = PD_STIFFNESS * observer.error + PD_DAMPING * observer.rate
        applied[k] = np.clip(tau[0], -head.robot.effort.numpy(), head.robot.effort.numpy())
        q, _ = head.step(tau, moving)
    tau = 0.5 * (applied[1:] + applied[:-1])
    tau = tau + noise.torque * np.sqrt(np.mean(tau**2, 0)) * rng.standard_normal(tau.shape)
    joints = head.robot.joint_names
    return Recording.from_arrays("recorded", joints, reference.t[1:], encoder[1:], tau, q_ref=reference.q[1:])
