"""Reference motions of the head: sums of sines and gaze shifts, joints in the order of ``head.urdf``."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

RATE_HZ = 500.0
DT = 1.0 / RATE_HZ  # s
REACH = np.array([0.35, 0.30, 0.50, 0.50, 0.40, 0.50, 0.40])  # rad; gaze stays within 60 degrees of straight ahead
NECK_HZ, EYE_HZ = 1.5, 3.0  # fastest sine of the motions that are controlled
RECORDED_NECK_HZ, RECORDED_EYE_HZ = 0.4, 5.0  # and of those that are recorded: a calm neck, eyes as fast as saccades
_SLOWEST_HZ, _SINES = 0.1, 6
_SHIFT_S, _REST_S = 0.6, 0.2  # neck and eyes of a person take 0.3 to 0.8 s for a large gaze shift


@dataclass(frozen=True)
class Motion:
    """A motion: t (N,) [s] and q, qd, qdd (N, n) [rad, per s, per s^2]."""

    t: np.ndarray
    q: np.ndarray
    qd: np.ndarray
    qdd: np.ndarray


def sines(t: np.ndarray, amplitude: np.ndarray, omega: np.ndarray, phase: np.ndarray) -> Motion:
    """Sum K sines a joint: q_j = sum_k amplitude_jk sin(omega_jk t + phase_jk).

    Args:
        t: (N,) [s].
        amplitude, omega, phase: (n, K) [rad, rad/s, rad].
    """
    angle = omega * t[:, None, None] + phase
    sin, cos = amplitude * np.sin(angle), amplitude * omega * np.cos(angle)
    return Motion(t, sin.sum(-1), cos.sum(-1), -(omega**2 * sin).sum(-1))


def multisine(rng: np.random.Generator, seconds: float, neck_hz: float, eye_hz: float) -> Motion:
    """Sum six sines a joint at ``RATE_HZ``, of equal speed, with frequencies that have no common period.

    Args:
        rng: draws frequencies and phases.
        seconds: duration.
        neck_hz, eye_hz: the fastest sine of the three neck joints and of the four eye joints.
    """
    t = np.arange(0.0, seconds, DT)
    fastest = np.repeat([neck_hz, eye_hz], (3, 4))
    omega = 2 * np.pi * np.geomspace(np.full_like(fastest, _SLOWEST_HZ), fastest, _SINES, axis=1)
    omega *= rng.uniform(0.85, 1.15, omega.shape)
    amplitude = rng.uniform(0.5, 1.0, omega.shape) / np.sqrt(omega)
    amplitude *= (REACH / amplitude.sum(1))[:, None]
    return sines(t, amplitude, omega, rng.uniform(0, 2 * np.pi, omega.shape))


def gaze_shifts(rng: np.random.Generator, seconds: float) -> Motion:
    """Move from posture to posture with minimum jerk at ``RATE_HZ``, with short rests between.

        q = q_0 + (q_1 - q_0) (10 s^3 - 15 s^4 + 6 s^5),   s = t / T

    Source: Flash, Hogan, "The Coordination of Arm Movements", J. Neuroscience 1985, eq. (3).
    """
    t = np.arange(0.0, seconds, DT)
    period = _SHIFT_S + _REST_S
    number = (t / period).astype(int)
    postures = REACH * rng.uniform(-1.0, 1.0, (number[-1] + 2, len(REACH)))
    start, change = postures[number], postures[number + 1] - postures[number]
    s = np.clip((t - number * period) / _SHIFT_S, 0.0, 1.0)[:, None]
    return Motion(
        t,
        start + change * (10 * s**3 - 15 * s**4 + 6 * s**5),
        change * 30 * (s**2 - 2 * s**3 + s**4) / _SHIFT_S,
        change * 60 * (s - 3 * s**2 + 2 * s**3) / _SHIFT_S**2,
    )
