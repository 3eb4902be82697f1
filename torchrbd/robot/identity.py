"""A fingerprint of a robot that does not depend on its inertial parameters."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict

from torchrbd.robot.model import RobotModel


def kinematics_sha256(robot: RobotModel) -> str:
    """Return the SHA-256 of the kinematics and the known torque: joints, axes, placements, rotors, springs.

    Two robots with the same value have the same regressor as a function of the states, up to gravity.
    """
    joints = [
        [j.name, j.kind, j.parent, j.child, j.pose.tolist(), j.axis.tolist(), j.armature, j.stiffness, j.rest]
        for j in robot.description.joints
    ]
    mimics = [j.mimic and asdict(j.mimic) for j in robot.description.joints]
    return hashlib.sha256(json.dumps([joints, mimics, robot.joint_names, robot.body_names]).encode()).hexdigest()
