"""Three controllers that use a robot's parameters, and what each of them makes of a reference motion.

All gains were chosen before any method was compared: with the true parameters errors die out without overshoot, and
with the URDF's the head does not fall over. All see the same encoders through the same observer, and all know the
URDF's viscous friction D.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import torch
from torch import Tensor

from torchrbd import RobotModel
from torchrbd.parameters import PARAMETERS_PER_BODY

from .motion import Motion
from .robot import Observer, RealHead

KP, KD = 225.0, 30.0  # 1/s^2, 1/s: a critically damped error of 15 rad/s
STIFFNESS = torch.tensor([40.0, 20.0, 5.0, 0.08, 0.06, 0.08, 0.06], dtype=torch.float64)  # N m/rad, feedforward's PD
DAMPING = torch.tensor([4.0, 2.0, 0.5, 0.008, 0.006, 0.008, 0.006], dtype=torch.float64)  # N m s/rad
LOST = 0.7  # rad; further off, the head is stopped
GAZE_M = 0.5  # the point that an eye looks at lies so far ahead of it
_DIFFERENCE_S = 1e-5


@dataclass(frozen=True)
class Body:
    """A robot with B sets of inertial parameters pi (B, n_params), physical or not."""

    robot: RobotModel
    pi: Tensor

    def torque(self, q: Tensor, qd: Tensor, qdd: Tensor) -> Tensor:
        """Return Y(q, qd, qdd) pi + D qd for (B, ..., n): (B, ..., n)."""
        Y = self.robot.regressor(q, qd, qdd)
        return torch.einsum("b...ij,bj->b...i", Y, self.pi) + self.robot.damping * qd

    def mass_and_bias(self, q: Tensor, qd: Tensor) -> tuple[Tensor, Tensor]:
        """Return M (B, n, n) and the torque without acceleration h (B, n), at q, qd (B, n)."""
        n = self.robot.n_dof
        unit = torch.cat((torch.eye(n, dtype=q.dtype), torch.zeros(2, n, dtype=q.dtype)))
        moving = torch.zeros(n + 2, 1, dtype=q.dtype)
        moving[n] = 1.0
        tau = self.torque(q[:, None].expand(-1, n + 2, -1), moving * qd[:, None], unit.expand(len(q), -1, -1))
        M = (tau[:, :n] - tau[:, n + 1 :]).mT
        return 0.5 * (M + M.mT), tau[:, n]


@dataclass(frozen=True)
class Target:
    """The reference at one moment, q, qd, qdd (B, n)."""

    q: Tensor
    qd: Tensor
    qdd: Tensor


@dataclass(frozen=True)
class Command:
    """What a controller asks for: torque and its feedback part (B, n) [N m]; ``possible`` (B,) bool is False where the
    mass matrix is not positive definite."""

    tau: Tensor
    feedback: Tensor
    possible: Tensor


Controller = Callable[[Body, Target, Tensor, Tensor], Command]


def computed_torque(body: Body, target: Target, e: Tensor, ed: Tensor) -> Command:
    """Return tau = M(q) (qdd_d + KD ed + KP e) + h(q, qd); e, ed (B, n) are q_d - q and its rate."""
    M, h = body.mass_and_bias(target.q - e, target.qd - ed)
    correction = KD * ed + KP * e
    feedback = _apply(M, correction)
    _, info = torch.linalg.cholesky_ex(M)
    return Command(_apply(M, target.qdd) + feedback + h, feedback, info == 0)


def inverse_dynamics(body: Body, target: Target, e: Tensor, ed: Tensor) -> Command:
    """Return tau = ID(q_d, qd_d, qdd_d) + PD: the parameters feed forward only, and no mass matrix is needed."""
    feedback = DAMPING * ed + STIFFNESS * e
    feedforward = body.torque(target.q, target.qd, target.qdd)
    return Command(feedforward + feedback, feedback, torch.ones(len(e), dtype=torch.bool))


def operational_space(body: Body, target: Target, e: Tensor, ed: Tensor) -> Command:
    """Move both eyes' gaze points, and the posture in what the gaze leaves free.

        tau = J' L (a_x - Jd qd) + (1 - J' L J M^-1) M a_0 + h,   L = (J M^-1 J')^-1

    a_x and a_0 are the reference's accelerations of gaze points and joints with PD feedback on their errors.

    Source: Khatib, "A Unified Approach for Motion and Force Control of Robot Manipulators", IEEE RA 1987, eq. (51).
    """
    q, qd = target.q - e, target.qd - ed
    M, h = body.mass_and_bias(q, qd)
    factor, info = torch.linalg.cholesky_ex(M)
    factor = torch.where((info == 0)[:, None, None], factor, torch.eye(M.shape[-1], dtype=M.dtype))
    x, J, drift = gaze(body.robot, q, qd)
    x_d, J_d, drift_d = gaze(body.robot, target.q, target.qd)
    e_x, ed_x = x_d - x, _apply(J_d, target.qd) - _apply(J, qd)
    feedback_x, feedback_0 = KD * ed_x + KP * e_x, KD * ed + KP * e
    wanted_x = _apply(J_d, target.qdd) + drift_d - drift
    weight = torch.linalg.inv(J @ torch.cholesky_solve(J.mT, factor))

    def torque(a_x: Tensor, a_0: Tensor) -> Tensor:
        return _apply(J.mT @ weight, a_x - _apply(J, a_0)) + _apply(M, a_0)

    feedback = torque(feedback_x, feedback_0)
    return Command(torque(wanted_x, target.qdd) + feedback + h, feedback, info == 0)


CONTROLLERS: dict[str, Controller] = {
    "computed torque": computed_torque,
    "inverse dynamics": inverse_dynamics,
    "operational space": operational_space,
}


def gaze(robot: RobotModel, q: Tensor, qd: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return where the eyes look: sideways and upward coordinate of each eye's gaze point.

    Args:
        robot: the head.
        q, qd: (B, n).

    Returns:
        x (B, 4) [m], its Jacobian J (B, 4, n), and Jd qd (B, 4) [m/s^2].
    """
    R, p = robot.body_poses(torch.stack((q, q + _DIFFERENCE_S * qd, q - _DIFFERENCE_S * qd)))
    axes, eyes = _eyes(robot)
    z = (R @ axes.unsqueeze(-1)).squeeze(-1)
    points, jacobians = [], []
    for body, carried_by in eyes:
        point = p[..., body, :] + GAZE_M * R[..., body, :, 0]
        J = torch.linalg.cross(z, point.unsqueeze(-2) - p) * carried_by
        points.append(point[0, :, 1:])
        jacobians.append(J.mT[..., 1:, :])
    J = torch.cat(jacobians, -2)
    return torch.cat(points, -1), J[0], _apply(J[1] - J[2], qd) / (2 * _DIFFERENCE_S)


@lru_cache
def _eyes(robot: RobotModel) -> tuple[Tensor, list[tuple[int, Tensor]]]:
    """Return the joints' axes (n, 3), and each eye's body with the joints (n, 1) that carry it as 1."""
    axes = {joint.name: joint.axis for joint in robot.description.joints}
    eyes = []
    for eye in ("left_eye", "right_eye"):
        body = robot.body_names.index(eye)
        carry = [[float((robot.columns(joint) == PARAMETERS_PER_BODY * body).any())] for joint in range(robot.n_dof)]
        eyes.append((body, torch.tensor(carry, dtype=torch.float64)))
    return torch.stack([axes[name] for name in robot.joint_names]), eyes


@dataclass(frozen=True)
class Tracking:
    """How each of M methods followed all references.

    Attributes:
        errors: (M, 3) RMS over references, time and joints of position [rad], velocity [rad/s] and feedback [N m].
        failures: (M,) why a method failed, empty where it did not.
    """

    errors: np.ndarray
    failures: tuple[str, ...]


def follow(
    head: RealHead, controller: Controller, pis: Tensor, references: Sequence[Motion], encoder_noise: float, seed: int
) -> Tracking:
    """Let a controller with each method's parameters follow each reference on the real robot.

    Args:
        head: the real robot.
        controller: one of ``CONTROLLERS``.
        pis: (M, n_params) parameters by method.
        references: T motions of equal length.
        encoder_noise: standard deviation [rad]; the same draws for all methods.
        seed: of the noise.
    """
    n_methods, n_refs = len(pis), len(references)
    body = Body(head.robot, pis.repeat_interleave(n_refs, 0))
    wanted = [np.tile(np.stack([getattr(m, s) for m in references], 1), (1, n_methods, 1)) for s in ("q", "qd", "qdd")]
    steps, runs, n = wanted[0].shape
    jitter = encoder_noise * np.random.default_rng(seed).standard_normal((steps, n_refs, n))
    jitter = np.tile(jitter, (1, n_methods, 1))
    head.start(wanted[0][0], wanted[1][0])
    q, qd = wanted[0][0], wanted[1][0]
    observer = Observer(np.zeros_like(q))
    moving, reasons = np.ones(runs, dtype=bool), np.full(runs, "", dtype=object)
    squares = np.zeros((runs, 3))
    for k in range(steps):
        target = Target(*(torch.from_numpy(w[k]) for w in wanted))
        observer.update(wanted[0][k] - q - jitter[k])
        command = controller(body, target, torch.from_numpy(observer.error), torch.from_numpy(observer.rate))
        tau, feedback = command.tau.numpy(), command.feedback.numpy()
        _stop(moving, reasons, ~command.possible.numpy(), "mass matrix not positive definite")
        _stop(moving, reasons, ~np.isfinite(tau).all(1) | (np.abs(q - wanted[0][k]) > LOST).any(1), "lost the motion")
        signals = (q - wanted[0][k], qd - wanted[1][k], feedback)
        squares += np.where(moving[:, None], np.stack([(s**2).mean(1) for s in signals], 1), 0.0)
        q, qd = head.step(tau, moving)
    errors = np.sqrt(squares.reshape(n_methods, n_refs, 3).mean(1) / steps)
    failures = tuple(next(filter(None, own), "") for own in reasons.reshape(n_methods, n_refs))
    errors[[bool(reason) for reason in failures]] = np.nan
    return Tracking(errors, failures)


def _stop(moving: np.ndarray, reasons: np.ndarray, now: np.ndarray, why: str) -> None:
    """Take runs out of the race, and say why."""
    reasons[moving & now] = why
    moving &= ~now


def _apply(A: Tensor, x: Tensor) -> Tensor:
    """Return A x for (B, m, n) and (B, n)."""
    return (A @ x.unsqueeze(-1)).squeeze(-1)
