"""Motions that people really record, of the demo's arm with friction, simulated by MuJoCo's inverse dynamics."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

import torchrbd

DEMO = Path(torchrbd.__file__).parent / "demo" / "arm.urdf"
JOINTS = tuple(f"joint{k}" for k in range(1, 7))
VISCOUS = np.array([3.0, 3.0, 2.0, 0.5, 0.5, 0.1])
COULOMB = np.array([4.0, 4.0, 2.4, 0.6, 0.5, 0.08])
RATE_HZ, ENCODER_STD, TORQUE_NOISE = 100.0, 2e-5, 0.01
_REST = np.array([0.2, -0.4, 0.6, 0.3, 0.5, -0.2])
_SPEEDS = np.array([1.0, 0.6, 0.8, 1.2, 1.0, 1.3])

Table = dict[str, np.ndarray]


@dataclass(frozen=True)
class Course:
    """Times (N,) and states (N, 6) of a motion. Where qd is zero, friction holds."""

    t: np.ndarray
    q: np.ndarray
    qd: np.ndarray
    qdd: np.ndarray

    def locked(self, joint: int) -> Course:
        """Return the same with one joint locked."""
        q, qd, qdd = self.q.copy(), self.qd.copy(), self.qdd.copy()
        q[:, joint], qd[:, joint], qdd[:, joint] = _REST[joint], 0.0, 0.0
        return Course(self.t, q, qd, qdd)


def sines(seed: int, duration_s: float, *, one_way: bool = False) -> Course:
    """Four sines a joint; with ``one_way`` on top of a speed at which none turns."""
    rng, t = np.random.default_rng(seed), np.arange(0.0, duration_s, 1.0 / RATE_HZ)[:, None]
    w, phase, a = 2 * np.pi * rng.uniform(0.1, 0.8, (4, 6)), rng.uniform(0, 6.28, (4, 6)), rng.uniform(0.1, 0.4, (4, 6))
    parts = list(zip(w, phase, a, strict=True))
    q = _REST + sum(a / w * np.sin(w * t + p) for w, p, a in parts)
    qd = np.asarray(sum(a * np.cos(w * t + p) for w, p, a in parts))
    speed = (0.15 - qd.min(0)) * one_way
    return Course(t[:, 0], q + speed * t, qd + speed, np.asarray(sum(-a * w * np.sin(w * t + p) for w, p, a in parts)))


def one_at_a_time(each_s: float = 4.0) -> Course:
    """One joint after the other swings, with its neighbours at rest."""
    t = np.arange(0.0, 6 * each_s, 1.0 / RATE_HZ)
    q, (qd, qdd) = np.tile(_REST, (len(t), 1)), np.zeros((2, len(t), 6))
    w, size = 4 * np.pi, 0.6
    for j in range(6):
        s = np.clip(t / each_s - j, 0.0, 1.0)
        swell, swell1, swell2 = 16 * s**2 * (1 - s) ** 2, 32 * s * (1 - s) * (1 - 2 * s), 32 * (1 - 6 * s + 6 * s**2)
        x, x1, x2 = np.sin(w * s), w * np.cos(w * s), -(w**2) * np.sin(w * s)
        inside = (s > 0) & (s < 1)
        q[:, j] += size * swell * x
        qd[:, j] = inside * size * (swell1 * x + swell * x1) / each_s
        qdd[:, j] = inside * size * (swell2 * x + 2 * swell1 * x1 + swell * x2) / each_s**2
    return Course(t, q, qd, qdd)


def constant_speeds(speeds: tuple[float, ...], each_s: float = 2.0) -> Course:
    """All joints at one speed after the other [rad/s]: the standard friction test."""
    steps = np.repeat(speeds, round(each_s * RATE_HZ))
    kernel = np.hanning(41)[1:-1] / np.hanning(41).sum()
    speed = np.convolve(np.concatenate((steps[:1].repeat(19), steps, steps[-1:].repeat(19))), kernel, "valid")
    qd = speed[:, None] * _SPEEDS
    q = _REST + np.cumsum(qd, 0) / RATE_HZ - 0.5 * qd / RATE_HZ
    return Course(np.arange(len(q)) / RATE_HZ, q, qd, np.gradient(qd, 1.0 / RATE_HZ, axis=0))


def recorded(course: Course, seed: int) -> Table:
    """Record a course: MuJoCo's torques of the arm, friction as ``VISCOUS`` and ``COULOMB`` say, noise."""
    model, rng = mujoco.MjModel.from_xml_path(str(DEMO)), np.random.default_rng(seed)
    # Joints may go round and round.
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    data, tau = mujoco.MjData(model), np.zeros_like(course.q)
    for k, (q, qd, qdd) in enumerate(zip(course.q, course.qd, course.qdd, strict=True)):
        data.qpos[:], data.qvel[:], data.qacc[:] = q, qd, qdd
        mujoco.mj_inverse(model, data)
        tau[k] = data.qfrc_inverse
    held = COULOMB * rng.uniform(-1.0, 1.0, 6)
    tau += np.where(course.qd == 0.0, held, COULOMB * np.sign(course.qd) + VISCOUS * course.qd)
    tau += TORQUE_NOISE * np.maximum(tau.std(0), 0.3) * rng.standard_normal(tau.shape)
    q = course.q + ENCODER_STD * rng.standard_normal(tau.shape)
    columns = {"q": q, "tau": tau}
    return {"t": course.t} | {f"{key}_{name}": x[:, j] for key, x in columns.items() for j, name in enumerate(JOINTS)}


def constant_column(table: Table) -> Table:
    """Return a table whose third encoder never moves by a step."""
    return table | {"q_joint3": np.full_like(table["t"], _REST[2])}


def without_torque(table: Table) -> Table:
    """Return a table without the third joint's torque."""
    return {name: column for name, column in table.items() if name != "tau_joint3"}


def _pair(course: Course, judged: Course, changed: Callable[[Table], Table] = lambda table: table) -> list[Table]:
    return [changed(recorded(one, seed)) for seed, one in enumerate((course, judged))]


CASES: dict[str, tuple[Callable[[], list[Table]], tuple[str, ...], tuple[str, ...]]] = {
    "a locked joint, its column constant": (
        lambda: _pair(sines(1, 20.0).locked(2), sines(2, 10.0).locked(2), constant_column),
        ("joint3",),
        (),
    ),
    "a locked joint, its encoder's noise alone": (
        lambda: _pair(sines(1, 20.0).locked(2), sines(2, 10.0).locked(2)),
        ("joint3",),
        (),
    ),
    "a joint that is locked in what is fitted alone": (
        lambda: _pair(sines(1, 20.0).locked(2), sines(2, 10.0)),
        ("joint3",),
        (),
    ),
    "one joint at a time": (lambda: _pair(one_at_a_time(), sines(2, 10.0)), (), ()),
    "constant speeds, up and down": (
        lambda: _pair(constant_speeds((0.2, -0.2, 0.5, -0.5, 0.8, -0.8)), constant_speeds((0.3, -0.3, 0.6, -0.6))),
        (),
        (),
    ),
    "constant speeds, one way": (
        lambda: _pair(constant_speeds((0.1, 0.3, 0.5, 0.7)), constant_speeds((0.2, 0.4))),
        (),
        (),
    ),
    "one direction only": (lambda: _pair(sines(1, 20.0, one_way=True), sines(2, 10.0)), (), ()),
    "a joint without torque": (lambda: _pair(sines(1, 20.0), sines(2, 10.0), without_torque), (), ("joint3",)),
}
"""By name: what makes recordings to fit and to judge by, joints that rest in the first, and those without a torque."""
