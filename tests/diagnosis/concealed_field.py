"""Recordings as arms give them: friction on every joint, coloured noise, drift, a coarse encoder, wrong CAD values."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
import torch
from robot.random_robots import random_urdf
from scipy.signal import lfilter
from simulated import inverse_dynamics, joint_names, multisine, with_wrong_inertials
from vision_head.motion import Motion

from torchrbd.dataset.band import band_hz
from torchrbd.diagnosis.outcome import SearchOutcome
from torchrbd.diagnosis.search import search_effects
from torchrbd.inference.preparation import read
from torchrbd.inference.settings import Settings
from torchrbd.likelihood.clocks import in_band
from torchrbd.recordings import Recording
from torchrbd.robot import RobotModel

RATE_HZ, DURATION_S, ENCODER_STEP = 125.0, 30.0, 2 * np.pi / 2**15
NOISE, COLOUR_S, DRIFT = 0.03, 0.08, 0.02


@dataclass(frozen=True)
class Truth:
    """What is concealed: at which joint (or link), when, in which interval of which signal."""

    joint: int
    link: str | None = None
    time_s: tuple[float, float] | None = None
    signal: str | None = None
    region: tuple[float, float] | None = None
    force: np.ndarray | None = None
    point: np.ndarray | None = None


@dataclass(frozen=True)
class Case:
    urdf: str
    cad: str
    recording: Recording
    holdout: Recording
    truth: Truth | None


Concealed = Callable[[np.random.Generator, str, Motion], tuple[np.ndarray, Truth]]


def arm(seed: int) -> str:
    return random_urdf(seed, 5 + seed % 3, kinds=("revolute",), branching=0.0, massless=0.0)


def background(one: Case, *recordings: Recording) -> SearchOutcome:
    """Return rigid body and baseline friction on recordings of a case, its own one by default, and no effects."""
    robot = RobotModel.from_urdf(one.cad)
    reading, _ = read(robot, recordings or [one.recording], Settings.from_mapping({}, "test"))

    def kept_back(_: str, t: torch.Tensor) -> torch.Tensor:
        return torch.zeros(len(t), dtype=torch.bool)

    clocks = in_band(reading, band_hz(reading.surveys), kept_back, frozenset())
    return search_effects(clocks.fit, (), lambda *_: None)


def case(seed: int, concealed: Concealed | None = None, size: float = 0.08, *, duration_s: float = DURATION_S) -> Case:
    """Make recordings of a random arm: one to fit and one of another motion to hold out, without what is concealed.

    Args:
        seed: of arm, motion, friction and noise.
        concealed: makes the torque of an effect, up to its size.
        size: RMS of that torque after projection on rigid body and friction, over the joint's torque RMS.
        duration_s: of the recording.
    """
    urdf = arm(seed)
    names = joint_names(urdf)
    rng = np.random.default_rng([seed, *(concealed.__name__ if concealed else "").encode()])
    friction = rng.uniform((0.05, 0.05, 0.02), (0.2, 0.2, 0.1), (len(names), 3))
    motion = multisine(len(names), seed, rate_hz=RATE_HZ, duration_s=duration_s, fastest_hz=0.8)
    other = multisine(len(names), seed + 50_000, rate_hz=RATE_HZ, duration_s=10.0, fastest_hz=0.8)
    rms = np.sqrt(np.mean(inverse_dynamics(urdf, motion) ** 2, 0))
    friction = friction * rms[:, None]
    torque, truth = None, None
    if concealed is not None:
        torque, truth = concealed(rng, urdf, motion)
        scale = size * rms[truth.joint] / projected_rms(urdf, motion, torque)[truth.joint]
        torque = scale * torque
        truth = replace(truth, force=None if truth.force is None else scale * truth.force)
    return Case(
        urdf,
        with_wrong_inertials(urdf, seed),
        _recorded("field", urdf, motion, friction, torque, rng),
        _recorded("other", urdf, other, friction, None, rng),
        truth,
    )


def _recorded(
    name: str,
    urdf: str,
    motion: Motion,
    friction: np.ndarray,
    torque: np.ndarray | None,
    rng: np.random.Generator,
) -> Recording:
    """Record a motion; friction (n, 3) is c_plus, c_minus [N m] and d [N m s/rad]."""
    tau = inverse_dynamics(urdf, motion)
    sign = np.tanh(motion.qd / 0.01)
    plus, minus, viscous = friction.T
    tau = tau + viscous * motion.qd + np.where(sign > 0, plus, minus) * sign + (0.0 if torque is None else torque)
    colour = np.exp(-1 / (RATE_HZ * COLOUR_S))
    noise = lfilter([np.sqrt(1 - colour**2)], [1.0, -colour], rng.standard_normal(tau.shape), axis=0)
    drift = np.cumsum(rng.standard_normal(tau.shape), 0) / np.sqrt(len(tau))
    tau = tau + np.sqrt(np.mean(tau**2, 0)) * (NOISE * noise + DRIFT * drift)
    q = np.round(motion.q / ENCODER_STEP) * ENCODER_STEP
    return Recording.from_arrays(name, joint_names(urdf), motion.t, q, tau)


def projected_rms(urdf: str, motion: Motion, torque: np.ndarray) -> np.ndarray:
    """Return the RMS (n,) of what rigid body, friction and offset cannot imitate of a torque (N, n)."""
    model = pin.buildModelFromXML(urdf)
    data, n = model.createData(), torque.shape[1]
    take = slice(None, None, 5)
    rows = [
        pin.computeJointTorqueRegressor(model, data, *row)
        for row in zip(motion.q[take], motion.qd[take], motion.qdd[take], strict=True)
    ]
    qd = motion.qd[take]
    own = np.stack((np.ones_like(qd), np.tanh(qd / 0.01), qd), -1)
    friction = np.einsum("tjk,ji->tjik", own, np.eye(n)).reshape(len(qd), n, 3 * n)
    D = np.concatenate((np.stack(rows), friction), 2)
    scale = np.sqrt(np.mean(torque[take] ** 2, 0)).clip(1e-3 * np.sqrt(np.mean(torque**2)))
    flat = (D / scale[:, None]).reshape(-1, D.shape[2])
    flat = flat / np.maximum(np.linalg.norm(flat, axis=0), 1e-12)
    y = (torque[take] / scale).ravel()
    left = y - flat @ np.linalg.lstsq(flat, y, rcond=1e-8)[0]
    return np.sqrt(np.mean(left.reshape(-1, n) ** 2, 0)) * scale


def _joint(rng: np.random.Generator, motion: Motion) -> int:
    return int(rng.integers(motion.q.shape[1]))


def _window(rng: np.random.Generator, motion: Motion) -> tuple[float, float]:
    end = motion.t[-1]
    start, length = rng.uniform(0.15, 0.55) * end, rng.uniform(0.12, 0.3) * end
    return start, start + length


def _inside(t: np.ndarray, interval: tuple[float, float]) -> np.ndarray:
    return ((t >= interval[0]) & (t <= interval[1])).astype(float)


def _at(motion: Motion, joint: int, torque: np.ndarray) -> np.ndarray:
    tau = np.zeros_like(motion.q)
    tau[:, joint] = torque
    return tau


def step(rng, urdf, motion):
    """A constant torque in a window of time."""
    j, window = _joint(rng, motion), _window(rng, motion)
    return _at(motion, j, _inside(motion.t, window)), Truth(j, time_s=window)


def rubbing(rng, urdf, motion):
    """More Coulomb friction in a window of time."""
    j, window = _joint(rng, motion), _window(rng, motion)
    return _at(motion, j, _inside(motion.t, window) * np.tanh(motion.qd[:, j] / 0.01)), Truth(j, time_s=window)


def payload(rng, urdf, motion):
    """A point mass on a link in a window of time."""
    model, window = pin.buildModelFromXML(urdf), _window(rng, motion)
    n = model.njoints - 1
    k = int(rng.integers(max(1, n - 3), n)) + 1
    inertia = pin.Inertia(1.0, rng.uniform(-0.2, 0.2, 3), 1e-3 * np.eye(3))
    data, loaded = model.createData(), pin.buildModelFromXML(urdf)
    loaded.inertias[k] += inertia
    more = loaded.createData()
    tau = np.stack(
        [
            pin.rnea(loaded, more, *row) - pin.rnea(model, data, *row)
            for row in zip(motion.q, motion.qd, motion.qdd, strict=True)
        ]
    )
    tau = tau * _inside(motion.t, window)[:, None]
    link = next(f.name for f in model.frames if f.parentJoint == k and f.type == pin.BODY)
    return tau, Truth(_most(urdf, motion, tau), link=link, time_s=window)


def push(rng, urdf, motion):
    """A constant force in the base's axes at a point of a link in a window of time."""
    model, window = pin.buildModelFromXML(urdf), _window(rng, motion)
    data, n = model.createData(), model.njoints - 1
    k = int(rng.integers(max(1, n - 3), n)) + 1
    point, force = rng.uniform(-0.2, 0.2, 3), rng.normal(size=3)
    tau = np.zeros_like(motion.q)
    for i, q in enumerate(motion.q):
        if window[0] <= motion.t[i] <= window[1]:
            J = pin.computeJointJacobian(model, data, q, k)
            pin.forwardKinematics(model, data, q)
            f = data.oMi[k].rotation.T @ force
            tau[i] = -J.T @ np.concatenate((f, np.cross(point, f)))
    link = next(f.name for f in model.frames if f.parentJoint == k and f.type == pin.BODY)
    return tau, Truth(_most(urdf, motion, tau), link=link, time_s=window, force=force, point=point)


def _most(urdf: str, motion: Motion, tau: np.ndarray) -> int:
    """Return the joint whose own torque a torque changes most."""
    return int(np.argmax(np.mean(tau**2, 0) / np.mean(inverse_dynamics(urdf, motion) ** 2, 0)))


def _stretch(rng: np.random.Generator, q: np.ndarray) -> tuple[float, float]:
    low = rng.uniform(0.2, 0.5)
    return tuple(np.quantile(q, (low, low + rng.uniform(0.15, 0.3))))  # type: ignore[return-value]


def sticky(rng, urdf, motion):
    """Coulomb friction in an interval of the joint's position."""
    j = _joint(rng, motion)
    region = _stretch(rng, motion.q[:, j])
    torque = _inside(motion.q[:, j], region) * np.tanh(motion.qd[:, j] / 0.01)
    return _at(motion, j, torque), Truth(j, signal=f"q_{joint_names(urdf)[j]}", region=region)


def bump(rng, urdf, motion):
    """A torque at one angle; its region is the full width at half maximum."""
    j = _joint(rng, motion)
    low, high = _stretch(rng, motion.q[:, j])
    centre, width = (low + high) / 2, (high - low) / 2.355
    torque = np.exp(-0.5 * ((motion.q[:, j] - centre) / width) ** 2)
    return _at(motion, j, torque), Truth(j, signal=f"q_{joint_names(urdf)[j]}", region=(low, high))


def taut(rng, urdf, motion):
    """A spring that acts beyond an angle only."""
    j = _joint(rng, motion)
    q = motion.q[:, j]
    edge = float(np.quantile(q, rng.uniform(0.5, 0.75)))
    return _at(motion, j, np.maximum(q - edge, 0)), Truth(
        j, signal=f"q_{joint_names(urdf)[j]}", region=(edge, float(q.max()))
    )


def cable(rng, urdf, motion):
    """A torque in an interval of another joint's position."""
    j = _joint(rng, motion)
    other = (j + int(rng.integers(1, motion.q.shape[1]))) % motion.q.shape[1]
    region = _stretch(rng, motion.q[:, other])
    return _at(motion, j, _inside(motion.q[:, other], region)), Truth(
        j, signal=f"q_{joint_names(urdf)[other]}", region=region
    )


def ripple(rng, urdf, motion):
    """Torque ripple over the position."""
    j = _joint(rng, motion)
    return _at(motion, j, np.sin(rng.uniform(4, 12) * motion.q[:, j] + rng.uniform(0, 6))), Truth(j)


def stribeck(rng, urdf, motion):
    """More friction at low speed."""
    j = _joint(rng, motion)
    qd = motion.qd[:, j]
    return _at(motion, j, np.tanh(qd / 0.01) * np.exp(-((qd / 0.2) ** 2))), Truth(j)


def coupling(rng, urdf, motion):
    """A spring to another joint."""
    j = _joint(rng, motion)
    other = (j + int(rng.integers(1, motion.q.shape[1]))) % motion.q.shape[1]
    return _at(motion, j, motion.q[:, other]), Truth(j)


def warming(rng, urdf, motion):
    """Coulomb friction that fades as the joint warms up."""
    j = _joint(rng, motion)
    return _at(motion, j, np.tanh(motion.qd[:, j] / 0.01) * np.exp(-motion.t / (0.4 * motion.t[-1]))), Truth(j)


def lag(rng, urdf, motion):
    """A torque that comes late."""
    j = _joint(rng, motion)
    return _at(motion, j, np.gradient(inverse_dynamics(urdf, motion)[:, j], motion.t)), Truth(j)


CONCEALED: dict[str, Concealed] = {
    f.__name__: f
    for f in (step, rubbing, payload, push, sticky, bump, taut, cable, ripple, stribeck, coupling, warming, lag)
}
