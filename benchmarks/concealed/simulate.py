"""Move a robot in MuJoCo with concealed effects under a controller with feedback, and record it ideally."""

# pyright: reportAttributeAccessIssue=false
# (MuJoCo ships no type stubs)

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from scipy.signal import butter, sosfiltfilt

from .background import Background
from .contract import Effect, Now, Record
from .motion import Motion, Path, direction
from .robots import Robot

STEP = 0.0005
"""Length of a step [s]; MuJoCo's velocities are half of it late."""
_CHATTER_HZ = 15.0
_FURTHEST, _FASTEST = 0.35, 1.6  # rad off the set-point; speed in parts of the set-point's highest


# Else MuJoCo writes a log file where one happens to be.
mujoco.set_mju_user_warning(lambda text: None)


class Refused(Exception):  # noqa: N818
    """A draw that no case is made of: it does not stay on its path, or cannot reach the size that is asked for."""


@dataclass(frozen=True)
class Controller:
    """PD, or computed torque by the robot's URDF.

    Attributes:
        urdf: the robot as the controller knows it.
        inertia: (n,) [kg m^2] by which PD gains are scaled.
        pace: of the error's decay [1/s].
        computed: computed torque rather than feed-forward and PD.
    """

    urdf: Robot
    inertia: np.ndarray
    pace: float
    computed: bool


def load_model(urdf: str) -> mujoco.MjModel:
    """Read a URDF as a MuJoCo model that adds no physics of its own."""
    model = mujoco.MjModel.from_xml_string(urdf)
    model.opt.timestep = STEP
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_LIMIT | mujoco.mjtDisableBit.mjDSBL_CONTACT
    # As hard as the step allows: friction is c sign(qd) except within a mrad/s of rest.
    model.dof_solref[:] = [2 * STEP, 1.0]
    model.dof_solimp[:] = [0.999, 0.999, 0.001, 0.5, 2.0]
    return model


@dataclass(frozen=True)
class Run:
    """What an ideal recorder saw: t (N,), q, qd, qdd of the encoders and commanded torque (N, n), at every step.

    Temperatures and ``slip`` are as in ``Motion``.
    """

    file: str
    t: np.ndarray
    q: np.ndarray
    qd: np.ndarray
    qdd: np.ndarray
    command: np.ndarray
    temperature: np.ndarray
    slip: np.ndarray

    def recorded(self, effects: Sequence[Effect]) -> Record:
        """Return what sensors with their effects write, without noise."""
        record = Record(self.t, self.q.copy(), self.command.copy())
        for effect in effects:
            effect.sense(record)
        return record

    def motion(self, robot: Robot, effects: Sequence[Effect], every: int) -> tuple[Motion, np.ndarray]:
        """Return the recorded motion and torque (N, n) at each ``every``-th step.

        Where motors are apart from their links, all of it is smoothed: they chatter, faster than any recorder follows.
        """
        record = self.recorded(effects)
        signals = record.q, self.qd, self.qdd, record.tau, self.slip
        if any(effect.by_difference for effect in effects):
            sos = butter(2, _CHATTER_HZ, fs=1 / STEP, output="sos")
            signals = [sosfiltfilt(sos, x, axis=0) for x in signals]
        q, qd, qdd, tau, slip = (x[::every] for x in signals)
        load = robot.torque(q, qd, qdd)
        return Motion(robot, self.file, self.t[::every], q, qd, qdd, load, self.temperature[::every], slip), tau


def simulate(
    robot: Robot,
    background: Background,
    effects: Sequence[Effect],
    path: Path,
    controller: Controller,
    feed_forward: np.ndarray,
    file: str,
    temperature: np.ndarray,
) -> Run:
    """Follow a path.

    Args:
        robot: the true one.
        background: friction of every joint.
        effects: concealed ones.
        path: set-point at every step.
        feed_forward: (N, n) torque that the controller adds to what it computes by itself.
        file: name of the recording.
        temperature: (N, n) of the joints.

    Raises:
        Refused: the robot left its path.
    """
    bare, loaded = _models(robot, effects)
    data, n = mujoco.MjData(bare), robot.n
    data.qpos[:], data.qvel[:], data.qacc[:] = path.q[0], path.qd[0], path.qdd[0]
    mujoco.mj_inverse(bare, data)
    bodies = slice(bare.nbody - n, bare.nbody)
    places = data.xfrc_applied[bodies], data.xpos[bodies], data.xipos[bodies]
    now = Now(file, STEP, data.qpos, data.qvel, data.qfrc_inverse.copy(), temperature[0], *places)
    for effect in effects:
        effect.begin(now)
    acting_on = [background.act, *(e.act for e in effects if type(e).act is not Effect.act)]
    driving = [e.drive for e in effects if type(e).drive is not Effect.drive]
    windows = [e.window for e in effects if e.window is not None and type(e).change is not Effect.change]
    control = _control(controller, now, path, feed_forward)
    q, qd, command, held = np.empty((4, len(path.t), n))
    level = np.empty_like(q)
    for k, t in enumerate(path.t.tolist()):
        now.t, now.temperature = t, temperature[k]
        now.push[:], now.level[:], now.damping[:] = 0.0, 0.0, 0.0
        for act in acting_on:
            act(now)
        # The order matters: gears that yield refresh what the encoders see when they are driven.
        torque = control(k)
        q[k], qd[k], command[k] = now.seen_q, now.seen_qd, torque
        for drive in driving:
            drive(now, torque)
        model = loaded if any(window.holds(now) for window in windows) else bare
        data.qfrc_applied[:] = torque - now.push
        model.dof_frictionloss[:], model.dof_damping[:] = now.level, now.damping
        mujoco.mj_step(model, data)
        if k % 1000 == 0 and not np.abs(now.seen_q - path.q[k]).max() < _FURTHEST:
            raise Refused("left its path")
        held[k], level[k] = data.qfrc_constraint, now.level
        now.load[:] = data.qfrc_applied + data.qfrc_passive + data.qfrc_constraint
        if now.seen_q is not now.q:
            _refresh(now, effects)
    _check(q, qd, path)
    qdd = np.diff(qd, axis=0, append=2 * qd[-1:] - qd[-2:-1]) / STEP
    slip = np.where(level > 0, -held / np.maximum(level, 1e-300), direction(qd))
    return Run(file, path.t, q, qd, qdd, command, temperature, slip)


def _models(robot: Robot, effects: Sequence[Effect]) -> tuple[mujoco.MjModel, mujoco.MjModel]:
    """Return the real robot outside and inside of the effects' windows."""
    bare = load_model(robot.urdf)
    for effect in effects:
        if effect.window is None:
            effect.change(bare)
    loaded = copy.copy(bare)
    for effect in effects:
        if effect.window is not None:
            effect.change(loaded)
    return bare, loaded


def _refresh(now: Now, effects: Sequence[Effect]) -> None:
    """Let encoders see what moved: motors where they are apart from their links."""
    now.seen_q[:], now.seen_qd[:] = now.q, now.qd
    for effect in effects:
        effect.see(now)


def _control(controller: Controller, now: Now, path: Path, feed_forward: np.ndarray):
    """Return a function of the step that returns the commanded torque."""
    pace, gain = controller.pace, controller.inertia
    if not controller.computed:
        stiffness, damping = pace**2 * gain, 2 * pace * gain
        return lambda k: feed_forward[k] + stiffness * (path.q[k] - now.seen_q) + damping * (path.qd[k] - now.seen_qd)
    model = load_model(controller.urdf.urdf)
    data = mujoco.MjData(model)

    def computed(k: int) -> np.ndarray:
        data.qpos[:], data.qvel[:] = now.seen_q, now.seen_qd
        data.qacc[:] = path.qdd[k] + pace**2 * (path.q[k] - now.seen_q) + 2 * pace * (path.qd[k] - now.seen_qd)
        mujoco.mj_inverse(model, data)
        return data.qfrc_inverse + feed_forward[k]

    return computed


def _check(q: np.ndarray, qd: np.ndarray, path: Path) -> None:
    if not (np.isfinite(q).all() and np.isfinite(qd).all()):
        raise Refused("unstable")
    off = np.abs(q - path.q).max()
    if off > _FURTHEST:
        raise Refused(f"{off:.2f} rad off its path")
    ratio = (np.abs(qd).max(0) / (np.abs(path.qd).max(0) + 0.2)).max()
    if ratio > _FASTEST:
        raise Refused(f"{ratio:.1f} times as fast as its path")
