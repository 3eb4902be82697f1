"""A robot whose joints have been moved is the robot of a URDF that has them there."""

from __future__ import annotations

import re

import numpy as np
import pinocchio as pin
import torch
from robot.random_robots import random_urdf

from torchrbd.robot import RobotModel, joint_origins, with_moved_origins

URDF = random_urdf(8, 5, kinds=("revolute", "prismatic"), branching=0.4, massless=0.0)


def moves(robot: RobotModel, size: float) -> torch.Tensor:
    return size * torch.randn(robot.n_dof, 6, dtype=torch.float64, generator=torch.Generator().manual_seed(3))


def states(robot: RobotModel) -> torch.Tensor:
    return torch.randn(3, 7, robot.n_dof, dtype=torch.float64, generator=torch.Generator().manual_seed(4))


def test_moved_joints_are_those_of_pinocchio() -> None:
    robot = RobotModel.from_urdf(URDF)
    shift = moves(robot, 0.3)
    shift[:, 3:] = 0.0
    found = with_moved_origins(robot, shift)
    text = URDF
    for name, origin in zip(robot.joint_names, (joint_origins(robot) + shift[:, :3]).tolist(), strict=True):
        pattern = rf'(<joint name="{name}".*?<origin xyz=")[^"]*'
        text = re.sub(pattern, lambda m, o=origin: m[1] + " ".join(map(repr, o)), text, count=1, flags=re.DOTALL)
    model = pin.buildModelFromXML(text)
    data, order = model.createData(), [model.joints[model.getJointId(n)].idx_v for n in robot.joint_names]
    for q, qd, qdd in zip(*states(robot).numpy(), strict=True):
        given = np.empty((3, model.nv))
        given[:, order] = q, qd, qdd
        expected = pin.rnea(model, data, *given)[order]
        np.testing.assert_allclose(found.inverse_dynamics(*map(torch.tensor, (q, qd, qdd))), expected, rtol=1e-9)


def test_the_torques_change_as_the_slopes_by_origins_say() -> None:
    robot = RobotModel.from_urdf(URDF, gravity=[1.0, 2.0, -9.0])
    q, qd, qdd = states(robot)
    step = moves(robot, 1e-6)
    ends = (with_moved_origins(robot, way * step).inverse_dynamics(q, qd, qdd) for way in (1.0, -1.0))
    change = 0.5 * (next(ends) - next(ends))
    slopes = robot.origin_slopes(q, qd, qdd)
    torch.testing.assert_close(change, torch.einsum("njkx,kx->nj", slopes, step), rtol=1e-6, atol=1e-10)


def test_no_moves_are_the_robot() -> None:
    robot = RobotModel.from_urdf(URDF)
    same = with_moved_origins(robot, moves(robot, 0.0))
    q, qd, qdd = states(robot)
    torch.testing.assert_close(same.inverse_dynamics(q, qd, qdd), robot.inverse_dynamics(q, qd, qdd))
