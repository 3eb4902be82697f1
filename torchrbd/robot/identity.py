"""Which robot it is, whatever its bodies weigh."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict

from torchrbd.robot.model import RobotModel


def kinematics_sha256(robot: RobotModel) -> str:
    """Return the SHA-256 of where bodies are and of torque that is known: joints, axes, placements, rotors, springs.

    Regressors of robots with the same one are the same functions of the states, up to gravity.
    """
    joints = [
        [j.name, j.kind, j.parent, j.child, j.pose.tolist(), j.axis.tolist(), j.armature, j.stiffness, j.rest]
        for j in robot.description.joints
    ]
    mimics = [j.mimic and asdict(j.mimic) for j in robot.description.joints]
    return hashlib.sha256(json.dumps([joints, mimics, robot.joint_names, robot.body_names]).encode()).hexdigest()
