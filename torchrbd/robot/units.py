"""SI units of a joint's signals."""

from __future__ import annotations

from torchrbd.robot.model import RobotModel


def torque_unit(robot: RobotModel, joint: int) -> str:
    """Return the unit of a joint's torque, or force."""
    return "N" if bool(robot.prismatic[joint]) else "N m"
