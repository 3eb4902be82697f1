"""Positions of a robot's joints in their parent links, and the same robot with moved joints."""

from __future__ import annotations

from dataclasses import replace

import torch
from scipy.spatial.transform import Rotation
from torch import Tensor

from torchrbd.robot.model import RobotModel


def joint_origins(robot: RobotModel) -> Tensor:
    """Return the xyz of the <origin> of each driving joint, (n_dof, 3) [m]."""
    found = {joint.name: joint.pose[:3, 3] for joint in robot.description.joints}
    return torch.stack([found[name] for name in robot.joint_names])


def with_moved_origins(robot: RobotModel, moves: Tensor) -> RobotModel:
    """Return the robot with the <origin> of each driving joint shifted and turned in the parent link's axes.

    Its links keep their inertial parameters, which are relative to the joints. ``RobotModel.origin_slopes`` is the
    derivative of its torques at zero moves.

    Args:
        robot: the robot.
        moves: (n_dof, 6) shifts along x, y, z [m], and rotation vectors [rad].
    """
    of_joint = dict(zip(robot.joint_names, moves, strict=True))
    joints = []
    for joint in robot.description.joints:
        if joint.name in of_joint:
            shift, turn = of_joint[joint.name].split(3)
            pose = joint.pose.clone()
            pose[:3, 3] += shift
            pose[:3, :3] = torch.from_numpy(Rotation.from_rotvec(turn.numpy()).as_matrix()) @ pose[:3, :3]
            joint = replace(joint, pose=pose)
        joints.append(joint)
    return RobotModel(replace(robot.description, joints=tuple(joints)), gravity=robot.gravity)
