"""Seven-joint arms and noisy recordings of them to judge identification by; all dynamics are Pinocchio's.

The robot of a recording is the true one. An estimator is given ``perturbed`` of it, so that truth lies around the URDF.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib import metadata
from pathlib import Path

import numpy as np
import pinocchio as pin
from scipy.signal import lfilter
from simulated import Motion, inverse_dynamics
from vision_head.motion import sines

from torchrbd.recordings import Recording

FINAL = {
    "panda": ("panda_description/urdf/panda.urdf", "panda_joint"),
    "xarm7": ("xarm_description/urdf/xarm7.urdf", "joint"),
    "baxter": ("baxter_description/urdf/baxter.urdf", "left_"),
}
# The controller of the closed loop: error dynamics (s + 10)^2, velocity by differences through a first-order filter.
_STIFFNESS, _DAMPING, _VELOCITY_HZ, _STEPS = 100.0, 20.0, 15.0, 2


@dataclass(frozen=True)
class Truth:
    """What a noisy recording conceals.

    Attributes:
        t: (N,) [s].
        q, qd, qdd: (N, n) states without noise.
        tau: (N, n) torque without noise [N m]; tau = rnea(q, qd, qdd).
        pi: (10 n,) inertial parameters in RobotModel's order.
        q_ref: (N, n) set-point of the controller, which the recording has too; None where there is none.
    """

    t: np.ndarray
    q: np.ndarray
    qd: np.ndarray
    qdd: np.ndarray
    tau: np.ndarray
    pi: np.ndarray
    q_ref: np.ndarray | None


def final_robots() -> dict[str, str]:
    """Return the seven-joint arms of example-robot-data by name, grippers and other limbs merged into their links."""
    package = metadata.distribution("example-robot-data")
    folder = Path(str(package.locate_file("cmeel.prefix/share/example-robot-data/robots")))
    found = {}
    for name, (file, prefix) in FINAL.items():
        model = pin.buildModelFromUrdf(str(folder / file))
        locked = [k for k in range(1, model.njoints) if not model.names[k].startswith(prefix)]
        found[name] = urdf_text(pin.buildReducedModel(model, locked, pin.neutral(model)))
    return found


def development_robots(n_robots: int = 3) -> dict[str, str]:
    """Return random arms by name."""
    return {f"random{seed}": urdf_text(_random_arm(seed)) for seed in range(n_robots)}


def _random_arm(seed: int) -> pin.Model:
    """Return a serial arm that twists and bends in turn, masses from about 5 kg to 0.5 kg and lengths to match."""
    rng = np.random.default_rng([seed, 7])
    model, length = pin.Model(), 0.0
    for k in range(7):
        axis = np.array([0.0, 0.0, 1.0]) if k % 2 == 0 else np.array([0.0, 1.0, 0.0])
        offset = np.array([*rng.uniform(-0.05, 0.05, 2), length])
        placement = pin.SE3(pin.exp3(np.array([0.0, 0.0, rng.uniform(-1.0, 1.0)])), offset)
        joint = pin.JointModelRevoluteUnaligned(axis)
        bounds = (np.array([v]) for v in (100.0, 2.5, -2.5, 2.5))
        parent = model.addJoint(k, joint, placement, f"joint{k + 1}", *bounds)
        length = float(rng.uniform(0.15, 0.25)) * (1.0 - 0.08 * k)
        mass = 5.0 * 0.7**k * float(rng.uniform(0.7, 1.3))
        centre = np.array([*rng.uniform(-0.03, 0.03, 2), rng.uniform(0.3, 0.6) * length])
        radii = np.array([*(rng.uniform(0.15, 0.3, 2) * length), 0.3 * length])
        turn = pin.exp3(0.3 * rng.standard_normal(3))
        second = mass * turn @ np.diag(radii**2) @ turn.T
        inertia = pin.Inertia(mass, centre, np.trace(second) * np.eye(3) - second)
        model.appendBodyToJoint(parent, inertia, pin.SE3.Identity())
    return model


def urdf_text(model: pin.Model) -> str:
    """Write a Pinocchio model of revolute joints as URDF; the child link of joint X is X_link."""
    data, names = model.createData(), list(model.names)
    tags = ['<link name="base"/>']
    for k in range(1, model.njoints):
        joint, placement, parent = model.joints[k], model.jointPlacements[k], model.parents[k]
        if joint.nq != 1:
            raise ValueError(f"joint {names[k]} has {joint.nq} coordinates; expected one")
        pin.forwardKinematics(model, data, pin.neutral(model))
        axis = np.asarray(data.joints[k].S)[3:].ravel()
        body = model.inertias[k]
        I = body.inertia  # noqa: E741
        entries = {"ixx": I[0, 0], "ixy": I[0, 1], "ixz": I[0, 2], "iyy": I[1, 1], "iyz": I[1, 2], "izz": I[2, 2]}
        moments = " ".join(f'{name}="{float(value)!r}"' for name, value in entries.items())
        low, high = model.lowerPositionLimit[joint.idx_q], model.upperPositionLimit[joint.idx_q]
        speed, effort = model.velocityLimit[joint.idx_v], model.effortLimit[joint.idx_v]
        tags += [
            f'<link name="{names[k]}_link"><inertial><origin xyz="{_text(body.lever)}"/>'
            f'<mass value="{float(body.mass)!r}"/><inertia {moments}/></inertial></link>',
            f'<joint name="{names[k]}" type="revolute"><parent link="{names[parent] + "_link" if parent else "base"}"/>'
            f'<child link="{names[k]}_link"/><axis xyz="{_text(axis)}"/>'
            f'<origin xyz="{_text(placement.translation)}" rpy="{_text(pin.rpy.matrixToRpy(placement.rotation))}"/>'
            f'<limit lower="{low}" upper="{high}" velocity="{speed}" effort="{effort}"/></joint>',
        ]
    body_text = "\n  ".join(tags)
    return f'<?xml version="1.0"?>\n<robot name="arm">\n  {body_text}\n</robot>\n'


def _text(values: np.ndarray) -> str:
    return " ".join(repr(float(v)) for v in values)


def true_parameters(urdf: str) -> np.ndarray:
    """Return Pinocchio's inertial parameters (10 n,) about the joints' origins."""
    return np.concatenate([body.toDynamicParameters() for body in list(pin.buildModelFromXML(urdf).inertias)[1:]])


def perturbed(urdf: str, seed: int, size: float = 0.25) -> str:
    """Make a URDF wrong: every body gets another mass, and is stretched, sheared and shifted.

        J -> exp(size g) T J T',   T = [[1 + size/2 G, size/5 r g'], [0, 1]]

    with J the pseudo-inertia, g, G, g' standard normal and r the body's radius of gyration: physical again.
    """
    model, rng = pin.buildModelFromXML(urdf), np.random.default_rng([seed, 11])
    for k in range(1, model.njoints):
        J = model.inertias[k].toPseudoInertia().toMatrix()
        mass, lever = J[3, 3], J[:3, 3] / J[3, 3]
        radius = np.sqrt(np.trace(J[:3, :3] / mass - np.outer(lever, lever)))
        T = np.eye(4)
        T[:3, :3] += 0.5 * size * rng.standard_normal((3, 3))
        T[:3, 3] = 0.2 * size * radius * rng.standard_normal(3)
        J = np.exp(size * rng.standard_normal()) * T @ J @ T.T
        model.inertias[k] = pin.Inertia.FromPseudoInertia(pin.PseudoInertia.FromMatrix(J))
    return urdf_text(model)


def _motion(model: pin.Model, rng: np.random.Generator, duration_s: float, rate_hz: float, fastest_hz: float) -> Motion:
    """Sum eight sines of random frequency and phase per joint, within nine tenths of the joint's limits."""
    n, t = model.nv, np.arange(round(duration_s * rate_hz)) / rate_hz
    omega = 2 * np.pi * rng.uniform(0.1, fastest_hz, (n, 8))
    phase, speed = rng.uniform(0, 2 * np.pi, (n, 8)), rng.uniform(0.2, 0.8, (n, 8))
    free = sines(t, speed / omega, omega, phase)
    q, qd = free.q, free.qd
    low, high = np.maximum(model.lowerPositionLimit, -np.pi), np.minimum(model.upperPositionLimit, np.pi)
    room, fastest = 0.9 * (high - low), 0.9 * np.minimum(model.velocityLimit, 1e3)
    scale = np.minimum(1.0, np.minimum(room / np.ptp(q, axis=0), fastest / np.abs(qd).max(0)))
    slack = room - scale * np.ptp(q, axis=0)
    shift = 0.5 * (low + high) - scale * 0.5 * (q.max(0) + q.min(0)) + slack * rng.uniform(-0.5, 0.5, n)
    return Motion(t, scale * q + shift, scale * qd, scale * free.qdd)


def _tracked(model: pin.Model, wanted: Motion, noise: np.ndarray) -> tuple[Motion, np.ndarray]:
    """Let the robot follow a motion under computed-torque control that sees q + noise; return motion and torque.

    The controller has the true inertia, runs once a sample, and differentiates what it sees. Torque goes in a straight
    line to what is commanded and reaches it a sample later: what is recorded is what acts at that time, so that neither
    delay nor aliasing lies between motion and torque.
    """
    data, dt = model.createData(), wanted.t[1]
    blend, h = 1.0 - np.exp(-2 * np.pi * _VELOCITY_HZ * dt), dt / _STEPS
    q, qd = wanted.q[0].copy(), wanted.qd[0].copy()
    tau, velocity = pin.rnea(model, data, q, qd, wanted.qdd[0]).copy(), qd
    before = q + noise[0] - dt * qd
    states = np.empty((4, *wanted.q.shape))
    for k, (q_ref, qd_ref, qdd_ref) in enumerate(zip(wanted.q, wanted.qd, wanted.qdd, strict=True)):
        seen = q + noise[k]
        velocity = velocity + blend * ((seen - before) / dt - velocity)
        before = seen
        goal = qdd_ref + _STIFFNESS * (q_ref - seen) + _DAMPING * (qd_ref - velocity)
        command = pin.rnea(model, data, seen, velocity, goal).copy()
        slope = (command - tau) / _STEPS
        for step in range(_STEPS):
            middle, end = tau + 0.5 * slope, tau + slope
            a1 = pin.aba(model, data, q, qd, tau).copy()
            if step == 0:
                states[:, k] = q, qd, a1, tau
            v2 = qd + 0.5 * h * a1
            a2 = pin.aba(model, data, q + 0.5 * h * qd, v2, middle).copy()
            v3 = qd + 0.5 * h * a2
            a3 = pin.aba(model, data, q + 0.5 * h * v2, v3, middle).copy()
            v4 = qd + h * a3
            a4 = pin.aba(model, data, q + h * v3, v4, end).copy()
            q, qd = q + h / 6 * (qd + 2 * v2 + 2 * v3 + v4), qd + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
            tau = end
    return Motion(wanted.t, states[0], states[1], states[2]), states[3]


def noisy_recording(
    urdf: str,
    seed: int,
    *,
    loop: str = "open",
    duration_s: float = 20.0,
    rate_hz: float = 500.0,
    encoder_noise: float = 1e-3,
    torque_noise: float = 0.03,
    torque_colour_s: float = 0.0,
    fastest_hz: float = 1.5,
) -> tuple[Recording, Truth]:
    """Record a motion that never repeats.

    Args:
        urdf: the real robot, revolute joints only.
        seed: of motion and noise.
        loop: "open", the motion is prescribed; "closed", a controller follows it by the same noisy encoder samples that
            are recorded, so that their noise moves the robot and is in its torque.
        duration_s, rate_hz: of the recording; in closed loop of the controller too.
        encoder_noise: white, standard deviation [rad].
        torque_noise: standard deviation as part of each joint's torque RMS.
        torque_colour_s: time in which torque noise forgets itself (first-order autoregression); 0 for white.
        fastest_hz: of the motion's sines.
    """
    if loop not in ("open", "closed"):
        raise ValueError(f"loop is '{loop}'; expected 'open' or 'closed'")
    model = pin.buildModelFromXML(urdf)
    shaken, encoders, sensors = (np.random.default_rng([seed, k]) for k in range(3))
    wanted = _motion(model, shaken, duration_s, rate_hz, fastest_hz)
    noise = encoder_noise * encoders.standard_normal(wanted.q.shape)
    motion, tau = (wanted, inverse_dynamics(urdf, wanted)) if loop == "open" else _tracked(model, wanted, noise)
    coloured = _autoregression(sensors, tau.shape, torque_colour_s * rate_hz)
    measured = tau + torque_noise * np.sqrt(np.mean(tau**2, 0)) * coloured
    q_ref = wanted.q if loop == "closed" else None
    names = list(model.names)[1:]
    recording = Recording.from_arrays(f"{loop}{seed}", names, motion.t, motion.q + noise, measured, q_ref=q_ref)
    return recording, Truth(motion.t, motion.q, motion.qd, motion.qdd, tau, true_parameters(urdf), q_ref)


def _autoregression(rng: np.random.Generator, shape: tuple[int, ...], samples: float) -> np.ndarray:
    """Return stationary noise of unit variance (N, n) whose correlation falls by 1/e in so many samples."""
    white = rng.standard_normal(shape)
    if samples == 0.0:
        return white
    pole = np.exp(-1.0 / samples)
    white[1:] *= np.sqrt(1 - pole**2)
    return np.asarray(lfilter([1.0], [1.0, -pole], white, axis=0))


def torque_nmse(
    urdf: str, pi: np.ndarray, seed: int, *, duration_s: float = 40.0, rate_hz: float = 50.0, fastest_hz: float = 1.5
) -> float:
    """Return how wrong parameters are on a motion of their own, without noise: the mean of the joints' nMSE.

    Args:
        urdf: the real robot.
        pi: (10 n,) parameters to judge, in RobotModel's order; they need not be physical.
        seed: of the motion, which differs from that of every recording.
        duration_s, rate_hz, fastest_hz: of the motion.
    """
    model = pin.buildModelFromXML(urdf)
    motion = _motion(model, np.random.default_rng([seed, 99]), duration_s, rate_hz, fastest_hz)
    tau, data = inverse_dynamics(urdf, motion), model.createData()
    rows = zip(motion.q, motion.qd, motion.qdd, strict=True)
    told = np.stack([pin.computeJointTorqueRegressor(model, data, *row) @ pi for row in rows])
    return float((np.mean((told - tau) ** 2, 0) / tau.var(0)).mean())
