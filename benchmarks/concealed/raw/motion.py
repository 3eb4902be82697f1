"""Set-points that never repeat: moves between random points, some with pauses, and sines that have no common period."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..robots import Robot

STYLES = ("moves", "sines", "both")
_LEAST_MOVE_S, _QUINTIC_PEAK = 0.5, 1.875


@dataclass(frozen=True)
class Way:
    """A set-point q, v, a (N, n) at times t (N,)."""

    t: np.ndarray
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    style: str


def draw_way(rng: np.random.Generator, robot: Robot, seconds: float, rate_hz: float) -> Way:
    """Draw a set-point inside the joints' limits, with speeds of a robot at work.

    Args:
        robot: whose limits hold.
        seconds: how long.
        rate_hz: of the samples.
    """
    low, high, fastest = robot.range()
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    # A place of work of its own, away from the straight arm.
    away = rng.uniform(-0.45, 0.45, robot.n)
    middle, half = middle + away * half, (1 - np.abs(away)) * half
    speed = np.minimum(fastest, 2.2) * rng.uniform(0.35, 0.8)
    t = np.arange(round(seconds * rate_hz)) / rate_hz
    style = str(rng.choice(STYLES))
    q = np.zeros((len(t), robot.n))
    if style != "sines":
        q += _moves(rng, t, 0.85 * half, speed)
    if style != "moves":
        q += _sines(rng, t, robot.n) * (0.3 if style == "both" else 1.0) * half
    v = np.gradient(q, t, axis=0)
    largest = np.maximum(np.abs(q).max(0) / (0.9 * half), np.abs(v).max(0) / speed)
    q = middle + q / np.maximum(largest, 1.0)
    v = np.gradient(q, t, axis=0)
    return Way(t, q, v, np.gradient(v, t, axis=0), style)


def _moves(rng: np.random.Generator, t: np.ndarray, half: np.ndarray, speed: np.ndarray) -> np.ndarray:
    """Return quintic moves of all joints at once, (N, n); a third of them end in a pause."""
    at, start = half * rng.uniform(-1, 1, len(half)), 0.0
    q = np.empty((len(t), len(half)))
    while start <= t[-1]:
        goal = half * rng.uniform(-1, 1, len(half))
        if rng.random() < 0.4:
            # Not every joint takes part in every move.
            goal = np.where(rng.random(len(half)) < 0.4, at, goal)
        least = float((_QUINTIC_PEAK * np.abs(goal - at) / speed).max())
        length = max(_LEAST_MOVE_S, least) * float(rng.uniform(1.0, 1.5))
        stop = start + length + (float(rng.uniform(0.1, 1.2)) if rng.random() < 1 / 3 else 0.0)
        rows = (t >= start) & (t < stop)
        s = np.minimum(1.0, (t[rows] - start) / length)
        q[rows] = at + (goal - at) * (s**3 * (10 - 15 * s + 6 * s**2))[:, None]
        at, start = goal, stop
    return q


def _sines(rng: np.random.Generator, t: np.ndarray, n: int) -> np.ndarray:
    """Return sines (N, n) of about unit size, held still in between where a case has pauses."""
    clock = _clock(rng, t)
    q = np.zeros((len(t), n))
    for joint in range(n):
        # Square roots of primes have no common period.
        roots = np.sqrt(rng.permutation([2, 3, 5, 7, 11, 13, 17, 19, 23, 29])[:5])
        hz = 0.08 * roots * rng.uniform(0.6, 1.1)
        size = rng.uniform(0.3, 1.0, 5) / hz
        phase = rng.uniform(-np.pi, np.pi, 5)
        q[:, joint] = np.sin(2 * np.pi * clock[:, None] * hz + phase) @ (size / size.sum())
    return q * rng.uniform(0.6, 1.0, n)


def _clock(rng: np.random.Generator, t: np.ndarray) -> np.ndarray:
    """Return a time that starts from rest and stops now and then, smoothly."""
    pace = np.clip(t / 0.8, 0.0, 1.0)
    if rng.random() < 0.5:
        for start in np.cumsum(rng.uniform(4.0, 12.0, 8)):
            length = rng.uniform(0.3, 1.0)
            pace *= np.clip((np.abs(t - start) - length) / 0.5, 0.0, 1.0)
    pace = pace**2 * (3 - 2 * pace)
    return np.concatenate([[0.0], np.cumsum(0.5 * (pace[1:] + pace[:-1]) * np.diff(t))])
