"""Recordings of simulated robots, their torques computed by Pinocchio, that is by nothing of ours."""

from __future__ import annotations

import re
from collections.abc import Mapping
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
from vision_head.motion import Motion, sines

from torchrbd.recordings import Recording


def multisine(
    n_dof: int, seed: int, *, duration_s: float = 30.0, rate_hz: float = 200.0, fastest_hz: float = 1.2
) -> Motion:
    """Sum six sines of random frequency and phase per joint, about 1 rad/s RMS."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, duration_s, 1.0 / rate_hz)
    omega = 2 * np.pi * rng.uniform(0.1, fastest_hz, (n_dof, 6))
    phase, speed = rng.uniform(0, 2 * np.pi, (n_dof, 6)), rng.uniform(0.3, 0.9, (n_dof, 6))
    moved = sines(t, speed / omega, omega, phase)
    return Motion(t, moved.q + rng.uniform(-1, 1, n_dof), moved.qd, moved.qdd)


def joint_names(urdf: str) -> list[str]:
    """Return Pinocchio's joints in its order."""
    return list(pin.buildModelFromXML(urdf).names)[1:]


def inverse_dynamics(urdf: str, motion: Motion, gravity: tuple[float, ...] = (0.0, 0.0, -9.81)) -> np.ndarray:
    """Return Pinocchio's torques (N, n), joints in its order; revolute and prismatic joints only."""
    model = pin.buildModelFromXML(urdf)
    model.gravity.linear = np.array(gravity)
    data = model.createData()
    rows = zip(motion.q, motion.qd, motion.qdd, strict=True)
    return np.stack([pin.rnea(model, data, *row).copy() for row in rows])


def record(
    urdf: str, seed: int, *, name: str = "simulated", extra=None, torque_noise: float = 0.02, encoder_noise: float =
        1e-5, gravity: tuple[float, ...] = (0.0, 0.0, -9.81), **motion_options
) -> Recording:  # fmt: skip
    """Record a motion.

    Args:
        urdf: the real robot.
        seed: of motion and noise.
        name: of the recording.
        extra: function of a Motion that returns additional torque (N, n).
        torque_noise: white, part of each joint's torque RMS.
        encoder_noise: white, [rad] or [m].
        gravity: in the base's axes [m/s^2].
    """
    names = joint_names(urdf)
    motion = multisine(len(names), seed, **motion_options)
    tau = inverse_dynamics(urdf, motion, gravity) + (0.0 if extra is None else extra(motion))
    rng = np.random.default_rng(seed + 10_000)
    tau = tau + torque_noise * np.sqrt(np.mean(tau**2, 0)) * rng.standard_normal(tau.shape)
    return Recording.from_arrays(name, names, motion.t, motion.q + encoder_noise * rng.standard_normal(tau.shape), tau)


def with_wrong_inertials(urdf: str, seed: int, size: float = 0.15) -> str:
    """Make every mass and centre of mass of a URDF wrong by ``size``, up or down at random; bodies stay physical."""
    rng = np.random.default_rng(seed)

    def changed(tag: re.Match[str]) -> str:
        mass, lever = (1.0 + size * rng.choice((-1.0, 1.0), 2)).tolist()
        text = re.sub(r'<mass value="([^"]+)"', lambda m: f'<mass value="{float(m[1]) * mass!r}"', tag[0])
        text = re.sub(r'((?:ixx|ixy|ixz|iyy|iyz|izz))="([^"]+)"', lambda m: f'{m[1]}="{float(m[2]) * mass!r}"', text)
        scaled = lambda m: 'xyz="' + " ".join(repr(float(v) * lever) for v in m[1].split()) + '"'  # noqa: E731
        return re.sub(r'xyz="([^"]+)"', scaled, text)

    return re.sub(r"<inertial>.*?</inertial>", changed, urdf, flags=re.S)


def with_lengths(urdf: str, factors: Mapping[str, float]) -> str:
    """Return a URDF whose joints sit so many times as far from their parent links."""
    root = ElementTree.fromstring(urdf)
    for joint in root.iter("joint"):
        origin = joint.find("origin")
        assert origin is not None
        xyz = (factors.get(str(joint.get("name")), 1.0) * float(x) for x in str(origin.get("xyz")).split())
        origin.set("xyz", " ".join(map(repr, xyz)))
    return ElementTree.tostring(root, encoding="unicode")
