"""Suspect wrong units from the range of values alone; nothing is fitted or corrected."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from torchrbd.recordings.channels import Channel
from torchrbd.recordings.mapping import TIME_UNITS
from torchrbd.recordings.recording import Recording
from torchrbd.recordings.survey import Survey
from torchrbd.robot import RobotModel

# Largest plausible angle, length and torque if the URDF has no limit: two turns, ten metres, 5000 N m.
_ANGLE, _LENGTH, _TORQUE = 4 * math.pi, 10.0, 5000.0
# Factors on the URDF's limits: values above the first are suspect; with the right unit they are within the second.
_BEYOND, _WITHIN = 2.0, 1.2
_SLOWEST_HZ, _RATES_HZ = 2.0, ((50.0, 5000.0), (5.0, 20000.0))


def suspected_units(
    recording: Recording, seen: Survey, channels: Sequence[Channel], robot: RobotModel | None = None
) -> dict[str, str]:
    """Return, by column, the unit that its values suggest, if it differs from the one they were read in.

    Args:
        recording: the recording.
        seen: its survey.
        channels: its columns.
        robot: for its limits; without it, those of usual robots.
    """
    found = {}
    time = recording.source("t", "")
    if time is not None and (unit := _time_unit(seen.rate_hz)):
        found[time.column] = unit
    for one in channels:
        k = recording.joints.index(one.joint)
        peak = max(abs(one.low), abs(one.high))
        if one.signal == "q":
            unit = _position_unit(peak, robot, k)
        elif one.signal == "tau":
            limit = _finite(float(robot.effort[k]), _TORQUE) if robot is not None else _TORQUE
            unit = "mN m" if peak > max(20 * limit, _TORQUE) else ""
        else:
            limit = float(robot.velocity[k]) if robot is not None else math.inf
            unit = "deg/s" if peak > 5 * limit and np.deg2rad(peak) < _BEYOND * limit else ""
        if unit:
            found[one.column] = unit
    return found


def _time_unit(rate_hz: float) -> str:
    """Return the unit in which the rate would be that of a robot; none if it is plausible in seconds."""
    if rate_hz > _SLOWEST_HZ:
        return ""
    for low, high in _RATES_HZ:
        for unit, seconds in TIME_UNITS.items():
            if unit != "s" and low <= rate_hz / seconds <= high:
                return unit
    return ""


def _position_unit(peak: float, robot: RobotModel | None, k: int) -> str:
    sliding = robot is not None and bool(robot.prismatic[k])
    unit, size, usual = ("mm", 1e-3, _LENGTH) if sliding else ("deg", math.pi / 180, _ANGLE)
    limit = math.inf if robot is None else float(np.fmax(abs(float(robot.lower[k])), abs(float(robot.upper[k]))))
    if math.isfinite(limit) and limit > 0:
        return unit if peak > _BEYOND * limit and peak * size < _WITHIN * limit else ""
    return unit if peak > usual and peak * size < usual else ""


def _finite(value: float, otherwise: float) -> float:
    return value if math.isfinite(value) and value > 0 else otherwise
