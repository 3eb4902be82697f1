"""Motions that never repeat, and what is known along a motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter1d

from .robots import Robot

KINDS = ("sines", "paused_sines", "points")
_FASTEST_HZ, _SINES = 0.9, 6


def direction(qd: np.ndarray) -> np.ndarray:
    """Return the sign of a velocity [rad/s]; 0 at rest, where friction is whatever holds."""
    return np.tanh(qd / 0.005)


@dataclass(frozen=True)
class Motion:
    """What is known along a recording, as it is recorded but without noise.

    Attributes:
        robot: the true one.
        file: name of the recording.
        t: (N,) [s], evenly spaced.
        q, qd, qdd: (N, n) recorded position [rad] and its derivatives.
        load: (N, n) rigid-body torque of that motion [N m].
        temperature: (N, n) of the joints [deg C].
        slip: (N, n) which part of its level friction takes, -1 to 1; where a joint sticks the speed does not tell. None
            where it is not known.
    """

    robot: Robot
    file: str
    t: np.ndarray
    q: np.ndarray
    qd: np.ndarray
    qdd: np.ndarray
    load: np.ndarray
    temperature: np.ndarray
    slip: np.ndarray | None = None

    def direction(self) -> np.ndarray:
        """Return the sign of the friction, (N, n); by the speed if it is not known better."""
        return direction(self.qd) if self.slip is None else self.slip


@dataclass(frozen=True)
class Path:
    """A set-point: q, qd, qdd (N, n) at times t (N,)."""

    t: np.ndarray
    q: np.ndarray
    qd: np.ndarray
    qdd: np.ndarray

    def every(self, step: int) -> Path:
        """Return each step-th sample."""
        return Path(self.t[::step], self.q[::step], self.qd[::step], self.qdd[::step])


def draw_path(
    rng: np.random.Generator, robot: Robot, kind: str, duration_s: float, rate_hz: float, held: int | None = None
) -> Path:
    """Draw a smooth motion within the robot's range of position and speed.

    Args:
        kind: "sines", sums of six sines a joint; "paused_sines", the same with stretches of rest; "points", trapezoids
            of speed with rounded corners between random points, with pauses.
        held: joint that stays where it is.
    """
    t = np.arange(round(duration_s * rate_hz)) / rate_hz
    low, high, fastest = robot.range()
    q, qd, qdd = _points(rng, t, robot.n) if kind == "points" else _sines(rng, t, robot.n, kind == "paused_sines")
    room = 0.85 * (high - low)
    wanted = np.minimum(room, 2 * np.pi * 0.6) * rng.uniform(0.6, 1.0, robot.n)
    scale = np.minimum(wanted / np.ptp(q, axis=0), 0.8 * fastest / np.abs(qd).max(0))
    if held is not None:
        scale[held] = 0.0
    slack = np.maximum(room - scale * np.ptp(q, axis=0), 0.0)
    middle = 0.5 * (low + high) + slack * rng.uniform(-0.4, 0.4, robot.n)
    return Path(t, middle + scale * (q - 0.5 * (q.max(0) + q.min(0))), scale * qd, scale * qdd)


def _sines(rng: np.random.Generator, t: np.ndarray, n: int, paused: bool) -> tuple[np.ndarray, ...]:
    clock, pace, haste = t, np.ones_like(t), np.zeros_like(t)
    if paused:
        # Time itself runs, slows down, rests and starts again.
        h, knots = t[1], np.arange(0.0, t[-1] + 1.5, 1.5)
        pace = uniform_filter1d(np.interp(t, knots, rng.random(len(knots)) > 0.3), round(0.4 / h), mode="nearest")
        clock, haste = h * np.cumsum(pace), np.gradient(pace, h)
    omega = 2 * np.pi * np.geomspace(0.07, _FASTEST_HZ, _SINES)[:, None] * rng.uniform(0.8, 1.2, (_SINES, n))
    amplitude = rng.uniform(0.4, 1.0, (_SINES, n)) / omega**0.8
    phase = rng.uniform(0, 2 * np.pi, (_SINES, n))
    angle = omega * clock[:, None, None] + phase
    q, qd, qdd = np.zeros((3, len(t), n))
    sin, cos = amplitude * np.sin(angle), amplitude * np.cos(angle)
    q, qd, qdd = sin.sum(1), (omega * cos).sum(1), -(omega**2 * sin).sum(1)
    return q, qd * pace[:, None], qdd * pace[:, None] ** 2 + qd * haste[:, None]


def _points(rng: np.random.Generator, t: np.ndarray, n: int) -> tuple[np.ndarray, ...]:
    """Drive each joint from point to point: speed rises and falls in straight lines, whose corners are rounded."""
    h, qd = t[1], np.empty((len(t), n))
    for j in range(n):
        times, speeds, now, at = [0.0], [0.0], float(rng.uniform(0.2, 1.0)), 0.0
        while now < t[-1]:
            goal = float(rng.uniform(-1, 1))
            length, ramp = float(rng.uniform(1.0, 3.0)), float(rng.uniform(0.2, 0.45))
            speed = (goal - at) / (length * (1 - ramp))
            times += [now, now + ramp * length, now + (1 - ramp) * length, now + length]
            speeds += [0.0, speed, speed, 0.0]
            now, at = now + length + float(rng.choice([0.05, rng.uniform(0.3, 1.2)], p=[0.6, 0.4])), goal
        qd[:, j] = np.interp(t, times, speeds)
    for width in (0.15, 0.1):
        qd = uniform_filter1d(qd, round(width / h), axis=0, mode="nearest")
    return h * np.cumsum(qd, axis=0), qd, np.gradient(qd, h, axis=0)


def draw_temperature(rng: np.random.Generator, n: int) -> tuple[np.ndarray, ...]:
    """Return (start, rise, time constant) of each joint's warming up, (n,) [deg C, K, s]."""
    return rng.uniform(20, 28, n), rng.uniform(8, 20, n), rng.uniform(10, 25, n)


def temperature_at(warming: tuple[np.ndarray, ...], t: np.ndarray) -> np.ndarray:
    """Return start + rise (1 - exp(-t / T)), (N, n)."""
    start, rise, T = warming
    return start + rise * -np.expm1(-t[:, None] / T)


def expected(robot: Robot, path: Path, file: str, temperature: np.ndarray) -> Motion:
    """Return the motion that a robot makes if it follows a set-point exactly."""
    load = robot.torque(path.q, path.qd, path.qdd)
    return Motion(robot, file, path.t, path.q, path.qd, path.qdd, load, temperature)


def finer(coarse_t: np.ndarray, values: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Interpolate (N, n) to other times in straight lines."""
    return np.stack([np.interp(t, coarse_t, column) for column in values.T], axis=1)
