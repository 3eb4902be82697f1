"""Describe each joint's motion, and whether it is enough to identify its friction and inertia."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from torchrbd.recordings.clock import uniform_blocks
from torchrbd.recordings.recording import Recording
from torchrbd.recordings.survey import Survey
from torchrbd.robot import RobotModel

Lack = Literal["any motion", "range", "speed", "reversals", "any reversal"]
_LAG_S = 0.05
# Fraction of the RMS speed below which the direction does not count.
_SLOW = 0.2
# Least motion of a joint: range and RMS speed [rad, rad/s; m, m/s], changes of direction.
_RANGE, _SPEED, _REVERSALS = (0.3, 0.03), (0.05, 0.005), 4


@dataclass(frozen=True)
class Motion:
    """Description of a joint's motion.

    Attributes:
        joint: its name.
        low, high: range [rad or m].
        speed_rms: [rad/s or m/s].
        reversals: number of changes of direction.
        lacks: what it has too little of; empty if it is rich enough.
    """

    joint: str
    low: float
    high: float
    speed_rms: float
    reversals: int
    lacks: tuple[Lack, ...]


def motions_of(recording: Recording, seen: Survey, robot: RobotModel | None = None) -> tuple[Motion, ...]:
    """Stream a recording once and describe the motion of its joints.

    Args:
        recording: the recording.
        seen: its survey.
        robot: to know prismatic joints; without it all count as revolute.
    """
    n, lag = len(recording.joints), max(1, round(_LAG_S / seen.clock.dt))
    sliding = np.zeros(n, dtype=bool) if robot is None else robot.prismatic.numpy()
    latest, segment, tail = np.zeros(n), -1, np.empty((n, 0))
    reversals = np.zeros(n, dtype=int)
    threshold = (_SLOW * seen.velocity_rms * lag * seen.clock.dt)[:, None]
    for block in uniform_blocks(recording, seen.clock):
        q = block.x[:n] if block.segment != segment else np.concatenate([tail, block.x[:n]], axis=1)
        segment, tail = block.segment, q[:, -lag:]
        moved = q[:, lag:] - q[:, :-lag]
        directions = np.where(np.abs(moved) > threshold, np.sign(moved), 0)
        for k in range(n):
            signs = np.concatenate([latest[k : k + 1], directions[k]])
            signs = signs[signs != 0]
            reversals[k] += int((np.diff(signs) != 0).sum())
            latest[k] = signs[-1] if len(signs) else 0
    span = seen.q_max - seen.q_min
    found = zip(seen.q_min, seen.q_max, seen.velocity_rms, reversals, strict=True)
    return tuple(
        Motion(joint, float(low), float(high), float(speed), int(turns), _lacks(span[k], speed, turns, sliding[k]))
        for k, (joint, (low, high, speed, turns)) in enumerate(zip(recording.joints, found, strict=True))
    )


def _lacks(span: float, speed: float, reversals: int, sliding: bool) -> tuple[Lack, ...]:
    if span == 0:
        return ("any motion",)
    lacks: list[Lack] = []
    if span < _RANGE[int(sliding)]:
        lacks.append("range")
    if speed < _SPEED[int(sliding)]:
        lacks.append("speed")
    if reversals < _REVERSALS:
        lacks.append("reversals" if reversals else "any reversal")
    return tuple(lacks)
