"""Small arms with known friction, noise and clock, their torques by Pinocchio, and the rows that are read of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import torch
from robot.random_robots import random_urdf
from simulated import Motion, inverse_dynamics, joint_names, multisine, with_wrong_inertials

from torchrbd.dataset.band import band_hz
from torchrbd.dataset.columns import Columns
from torchrbd.dataset.reading import Reading
from torchrbd.dataset.rows import KeptBack, Rows, read_rows
from torchrbd.dataset.scales import covered_scales
from torchrbd.inference.preparation import read
from torchrbd.inference.settings import Settings
from torchrbd.recordings import Filtering, Recording
from torchrbd.robot import RobotModel

NOISE, WIDTH = 0.02, 0.02
Torque = Callable[[Motion], np.ndarray]


def arm_urdf(seed: int = 0, n_joints: int = 2) -> str:
    return random_urdf(seed, n_joints, kinds=("revolute",), branching=0.0, massless=0.0, fixed=0.0)


def friction(viscous: Sequence[float], coulomb: Sequence[float], width: float = WIDTH) -> Torque:
    """Return d qd + c tanh(qd / w) of each joint."""
    return lambda m: np.array(viscous) * m.qd + np.array(coulomb) * np.tanh(m.qd / width)


def recorded(
    urdf: str,
    seed: int,
    extra: Torque | None = None,
    *,
    name: str = "simulated",
    noise: float = NOISE,
    encoder_noise: float = 0.0,
    delay_s: float = 0.0,
    lag_s: float = 0.0,
    gain: float = 1.0,
    missing: Sequence[str] = (),
    **motion_options: float,
) -> Recording:
    """Record a motion; the torque is ``delay_s`` late, its white noise is ``noise`` of each joint's RMS.

    With ``lag_s`` it is the command of actuators that follow with that time constant.
    """
    names = joint_names(urdf)
    moved = multisine(len(names), seed, **motion_options)

    def late(seconds: float) -> np.ndarray:
        at = moved if not seconds else _later(len(names), seed, moved, seconds, motion_options)
        return inverse_dynamics(urdf, at) + (0.0 if extra is None else extra(at))

    tau = late(delay_s)
    if lag_s:
        fine = 0.1 / motion_options.get("rate_hz", 200.0)
        tau = tau + lag_s * (late(delay_s - fine) - late(delay_s + fine)) / (2.0 * fine)
    rng = np.random.default_rng(seed + 10_000)
    tau = gain * (tau + noise * np.sqrt(np.mean(tau**2, 0)) * rng.standard_normal(tau.shape))
    tau[:, [n in missing for n in names]] = np.nan
    q = moved.q + encoder_noise * rng.standard_normal(moved.q.shape)
    return Recording.from_arrays(name, names, moved.t, q, tau)


def driven_columns(
    urdf: str,
    seed: int,
    extra: Torque,
    kp: np.ndarray,
    kd: np.ndarray,
    *,
    delay_s: float = 0.0,
    encoder_noise: float = 1e-5,
    torque_noise: float = 0.005,
    **motion_options: float,
) -> dict[str, np.ndarray]:
    """Return the columns t, q, qd and q_ref of a robot with position drives, which has no torque.

    The set-points are those that make the motion, q_ref = q + (tau + kd qd) / kp, recorded ``delay_s`` before the
    drives follow them. A disturbance torque is white, ``torque_noise`` of each joint's RMS.
    """
    names = joint_names(urdf)
    moved = multisine(len(names), seed, **motion_options)
    then = _later(len(names), seed, moved, -delay_s, motion_options) if delay_s else moved
    rng = np.random.default_rng(seed + 10_000)
    tau = inverse_dynamics(urdf, then) + extra(then)
    tau = tau + torque_noise * np.sqrt(np.mean(tau**2, 0)) * rng.standard_normal(tau.shape)
    signals = {
        "q": moved.q + encoder_noise * rng.standard_normal(tau.shape),
        "qd": moved.qd,
        "q_ref": then.q + (tau + kd * then.qd) / kp,
    }
    columns = {f"{key}_{name}": x[:, k] for key, x in signals.items() for k, name in enumerate(names)}
    return {"t": moved.t, **columns}


def _later(n: int, seed: int, moved: Motion, delay_s: float, options: dict[str, float]) -> Motion:
    """Return the motion as it was ``delay_s`` ago: a whole number of steps of a finer clock."""
    rate, fine = options.get("rate_hz", 200.0), 10
    steps = round(delay_s * rate * fine)
    other = multisine(n, seed, **{**options, "rate_hz": rate * fine})
    at = np.clip(fine * np.arange(len(moved.t)) - steps, 0, len(other.t) - 1)
    return Motion(moved.t, other.q[at], other.qd[at], other.qdd[at])


def reading_of(
    robot: RobotModel, recordings: Sequence[Recording], *, of_motion: bool = True, cutoff_hz: float | None = None
) -> tuple[Reading, Columns]:
    reading, _ = read(robot, recordings, Settings())
    band = band_hz(reading.surveys) if cutoff_hz is None else cutoff_hz
    reading = replace(reading, filtering=Filtering(band, of_motion=of_motion))
    return reading, Columns(robot, (), covered_scales(reading.surveys, reading.filtering))


def none_kept_back(name: str, t: torch.Tensor) -> torch.Tensor:
    return torch.zeros(len(t), dtype=torch.bool)


def rows_of(
    robot: RobotModel, recordings: Sequence[Recording], kept_back: KeptBack = none_kept_back, **options
) -> Rows:
    return read_rows(*reading_of(robot, recordings, **options), kept_back)


def wrong_robot(urdf: str, seed: int, size: float = 0.1) -> RobotModel:
    return RobotModel.from_urdf(with_wrong_inertials(urdf, seed, size))
