"""A MuJoCo arm under computed torque at 1 kHz, with friction that the integrator takes implicitly.

Friction of level c is c tanh(v / w): at each step a damping c tanh(|v| / w) / |v|, which MuJoCo's implicit integrator
multiplies with the speed after the step, so that it is stable however sharp its change of sign.
"""

# pyright: reportAttributeAccessIssue=false
# (MuJoCo ships no type stubs)

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace

import mujoco
import numpy as np
import pinocchio as pin
from scipy.signal import butter, sosfiltfilt

from ..robots import Robot
from ..simulate import Refused
from .bodies import CHANGED, changed_urdf, direction
from .laws import DRY, PUSH, Effect, Motion, dahl, late
from .motion import Way

STEP, CONTROL = 0.0005, 2
"""Length of a step [s], and of those the controller takes each so manyeth."""
_FURTHEST = 0.3
# A command faster than a recorder sees [Hz], beyond this part of its RMS, after the start [s]: the servo is unstable.
_SEEN_HZ, _CHATTERS, _START_S = 60.0, 0.02, 0.2


@dataclass(frozen=True)
class Friction:
    """Of all joints (n,): viscous [N m s/rad], Coulomb forwards and backwards [N m], width of its change [rad/s]."""

    viscous: np.ndarray
    plus: np.ndarray
    minus: np.ndarray
    width: np.ndarray

    def level(self, v: np.ndarray) -> np.ndarray:
        """Return the Coulomb level at speeds (..., n)."""
        return np.where(v > 0, self.plus, self.minus)

    def direction(self, v: np.ndarray) -> np.ndarray:
        """Return what part of its level friction takes, (..., n)."""
        return np.tanh(v / self.width)

    def torque(self, v: np.ndarray) -> np.ndarray:
        """Return its torque at speeds (..., n)."""
        return self.viscous * v + self.level(v) * self.direction(v)


@dataclass(frozen=True)
class Controller:
    """Computed torque by the URDF, with friction known in part.

    Attributes:
        urdf: the robot as the controller knows it.
        pace: of the decay of errors [1/s], were there no friction.
        stiffness: (n,) that friction calls for besides [N m/rad].
        knows: part of the friction that is fed forward.
    """

    urdf: Robot
    pace: float
    stiffness: np.ndarray
    knows: float


@dataclass(frozen=True)
class Track:
    """A simulated recording without noise.

    Attributes:
        x: what is true, at each step.
        q, tau: recorded positions [rad] and torques [N m], (N, n).
        friction: torque of the friction that every joint has, (N, n).
    """

    x: Motion
    q: np.ndarray
    tau: np.ndarray
    friction: np.ndarray


def model_of(robot: Robot, effect: Effect | None) -> mujoco.MjModel:
    """Return MuJoCo's model of a robot, changed by an effect."""
    text, gravity = changed_urdf(robot, effect)
    model = mujoco.MjModel.from_xml_string(text)
    model.opt.timestep, model.opt.gravity = STEP, gravity
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_LIMIT | mujoco.mjtDisableBit.mjDSBL_CONTACT
    if effect is not None and effect.id == "rotor_inertia":
        model.dof_armature[effect.joint] += effect.strength
    return model


def simulate(robot: Robot, friction: Friction, effect: Effect | None, way: Way, controller: Controller) -> Track:
    """Follow a set-point that is sampled at every step.

    Raises:
        Refused: the robot does not stay near it, or trembles.
    """
    bare = model_of(robot, None if effect is not None and effect.window else effect)
    model = with_effect = model_of(robot, effect)
    data, n, j = mujoco.MjData(bare), robot.n, -1 if effect is None else effect.joint
    data.qpos[:], data.qvel[:] = way.q[0], way.v[0]
    start, end = effect.window if effect is not None and effect.window else (0.0, np.inf)
    act, lag = _actions(robot, effect, data)
    known, feed = _known(controller, friction, way)
    now = SimpleNamespace(t=0.0, q=data.qpos, v=data.qvel, load=np.zeros(n))
    q, v, command, acting, level = np.empty((5, len(way.t), n))
    applied, tiny = known(0, data.qpos, data.qvel) + feed[0], 1e-9
    for k, t in enumerate(way.t.tolist()):
        if k % CONTROL == 0:
            wanted = known(k, data.qpos, data.qvel) + feed[k]
        applied = wanted if lag is None else applied + lag * (wanted - applied)
        q[k], v[k], command[k], acting[k] = data.qpos, data.qvel, wanted, applied
        speed, now.t, inside = np.abs(data.qvel) + tiny, t, start <= t < end
        model = with_effect if inside else bare
        more, push = act(now, inside)
        level[k] = friction.level(data.qvel)
        dry = level[k].copy()
        dry[j] += more
        damping = friction.viscous + dry * np.tanh(speed / friction.width) / speed
        model.dof_damping[:] = damping
        data.qfrc_applied[:] = applied
        data.qfrc_applied[j] -= push
        mujoco.mj_step(model, data)
        now.load[:] = data.qfrc_applied - damping * data.qvel
        if k % 500 == 0 and not np.abs(data.qpos - way.q[k]).max() < _FURTHEST:
            raise Refused("left its path")
    if not np.abs(q - way.q).max() < _FURTHEST:
        raise Refused("left its path")
    fast = sosfiltfilt(butter(4, _SEEN_HZ, "highpass", fs=1 / STEP, output="sos"), command, axis=0)
    rms = [np.sqrt(np.mean(x[round(_START_S / STEP) :] ** 2, axis=0)) for x in (fast, command)]
    if (rms[0] > _CHATTERS * rms[1]).any():
        raise Refused("its servo chatters")
    return _track(robot, friction, effect, way, (q, v, command, acting, level))


def _actions(robot: Robot, effect: Effect | None, data: mujoco.MjData):
    """Return what an effect does at a step, and the part of a step's change that lagging actuators follow."""
    if effect is None or effect.id in (*CHANGED, "rotor_inertia"):
        return (lambda now, inside: (0.0, 0.0)), None
    j, k, shape = effect.joint, effect.strength, effect.shape
    if effect.id in DRY:
        law = DRY[effect.id]
        return (lambda now, inside: (k * law(now, j, shape), 0.0)), None
    if effect.id in PUSH:
        law = PUSH[effect.id]
        return (lambda now, inside: (0.0, k * law(now, j, shape))), None
    if effect.id == "presliding_hysteresis":
        state = {"z": 0.0, "q": float(data.qpos[j])}

        def hysteresis(now: SimpleNamespace, inside: bool) -> tuple[float, float]:
            q = float(now.q[j])
            state["z"], state["q"] = dahl(state["z"], q - state["q"], shape["distance"]), q
            return 0.0, k * state["z"]

        return hysteresis, None
    if effect.id == "external_wrench":
        body, wrench = data.xfrc_applied.shape[0] - robot.n + j, k * direction(effect)

        def pushed(now: SimpleNamespace, inside: bool) -> tuple[float, float]:
            # MuJoCo's acts at the centre of mass. Its poses are those of the step before.
            arm = data.xpos[body] - data.xipos[body]
            data.xfrc_applied[body] = 0.0
            if inside:
                data.xfrc_applied[body, :3] = wrench[:3]
                data.xfrc_applied[body, 3:] = wrench[3:] + np.cross(arm, wrench[:3])
            return 0.0, 0.0

        return pushed, None
    if effect.id == "actuator_lag":
        follows = np.ones(robot.n)
        follows[j if j >= 0 else slice(None)] = 1.0 - np.exp(-STEP / k)
        return (lambda now, inside: (0.0, 0.0)), follows
    return (lambda now, inside: (0.0, 0.0)), None


def _known(controller: Controller, friction: Friction, way: Way):
    """Return the controller's computed torque as a function of the step, and what it feeds forward (N, n)."""
    model, pace = controller.urdf.model, controller.pace
    data, (inertia, _) = model.createData(), controller.urdf.inertias(way.q)
    more = controller.stiffness
    damping = 2 * np.sqrt(inertia * (more + pace**2 * inertia)) - 2 * pace * inertia

    def computed(k: int, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        off, slow = way.q[k] - q, way.v[k] - v
        wanted = way.a[k] + pace**2 * off + 2 * pace * slow
        return pin.rnea(model, data, q, v, wanted) + more * off + damping * slow

    soft = np.tanh(way.v / 0.05)
    return computed, controller.knows * (friction.viscous * way.v + friction.level(way.v) * soft)


def _track(robot: Robot, friction: Friction, effect: Effect | None, way: Way, series: tuple[np.ndarray, ...]) -> Track:
    """Put together what is true and what is recorded."""
    q, v, command, acting, level = series
    after = np.concatenate([v[1:], v[-1:]])
    a = (after - v) / STEP
    speed = np.abs(v) + 1e-9
    # The part of its level that friction took in the step, as the integrator has it.
    way_of = np.tanh(speed / friction.width) / speed * after
    x = Motion(way.t, q, v, a, np.zeros_like(q), way_of, acting)
    seen, tau = q, command
    if effect is not None:
        sign, k, j = effect.shape.get("sign", 1.0), effect.strength, effect.joint
        joints = slice(None) if j < 0 else [j]
        if effect.id == "torque_scale":
            tau = command.copy()
            tau[:, joints] *= 1 + sign * k
        elif effect.id == "torque_offset":
            tau = command.copy()
            tau[:, j] += sign * k
        elif effect.id == "time_delay":
            tau = command.copy()
            for i in range(robot.n) if j < 0 else [j]:
                tau[:, i] = late(way.t, command[:, i], sign * k)
        elif effect.id == "encoder_offset":
            seen = q.copy()
            seen[:, j] += sign * k
    return Track(x, seen, tau, friction.viscous * after + level * way_of)
