"""Jacobians and derivatives of the torques: against Pinocchio's analytic ones, and its robots with moved joints."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from robot.random_robots import random_states, random_urdf
from robot.test_robot_pinocchio import Reference
from torch.autograd import gradcheck

from torchrbd.robot import RobotModel

pin = pytest.importorskip("pinocchio")


def states(robot: RobotModel, seed: int, *batch: int) -> list[torch.Tensor]:
    return [torch.from_numpy(x) for x in random_states(seed, *batch, robot.n_dof)]


@pytest.mark.parametrize("seed", range(12))
def test_torque_slopes_are_pinocchios(seed: int) -> None:
    urdf = random_urdf(seed, 1 + seed % 8)
    robot = RobotModel.from_urdf(urdf)
    reference = Reference(urdf, robot)
    q, qd, qdd = (x.numpy() for x in states(robot, seed))
    args = reference.position(q), reference.velocity(qd), reference.velocity(qdd)
    pin.computeRNEADerivatives(reference.model, reference.data, *args)
    data, order = reference.data, np.ix_(reference.order, reference.order)
    slopes = robot.torque_slopes(*(torch.from_numpy(x) for x in (q, qd, qdd)))
    M = np.triu(data.M) + np.triu(data.M, 1).T
    for slope, expected in zip(slopes, (data.dtau_dq, data.dtau_dv, M), strict=True):
        np.testing.assert_allclose(slope.numpy(), expected[order], rtol=1e-10, atol=1e-10)


def test_torque_slopes_of_mimic_joints_are_those_of_autograd() -> None:
    robot = RobotModel.from_urdf(random_urdf(9, 4, mimic=0.3))
    assert robot.n_dof < robot.n_bodies
    x = tuple(states(robot, 2))
    expected = torch.autograd.functional.jacobian(robot.inverse_dynamics, x)
    torch.testing.assert_close(robot.torque_slopes(*x), torch.stack(expected), rtol=1e-11, atol=1e-11)


@pytest.mark.parametrize("seed", range(6))
def test_jacobian_is_pinocchios(seed: int) -> None:
    urdf = random_urdf(seed, 6)
    robot = RobotModel.from_urdf(urdf)
    reference = Reference(urdf, robot)
    q = states(robot, seed)[0]
    pin.computeJointJacobians(reference.model, reference.data, reference.position(q.numpy()))
    for body, name in enumerate(robot.joint_names):
        joint = reference.model.getJointId(name)
        frame = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        J = pin.getJointJacobian(reference.model, reference.data, joint, frame)[:, reference.order]
        assert np.abs(robot.jacobian(q, body).numpy() - J).max() < 1e-12


def moved(reference: Reference, urdf: str, joint: str, shift: np.ndarray, turn: np.ndarray) -> Reference:
    """Return Pinocchio's robot with the joint's origin moved in its parent link's axes."""
    model = pin.buildModelFromXML(urdf)
    number = model.getJointId(joint)
    # The parent link may hang on its body by a fixed joint: the frame just above the joint has its axes.
    parent = model.frames[model.frames[model.getFrameId(joint)].parentFrame].placement.rotation
    old = model.jointPlacements[number]
    turned = pin.exp3(parent @ turn) @ old.rotation
    model.jointPlacements[number] = pin.SE3(turned, old.translation + parent @ shift)
    result = Reference.__new__(Reference)
    result.model, result.data, result.joints, result.order = (
        model,
        model.createData(),
        reference.joints,
        reference.order,
    )
    return result


@pytest.mark.parametrize("seed", range(6))
def test_origin_slopes_are_differences_of_moved_robots(seed: int) -> None:
    urdf = random_urdf(seed, 5, fixed=0.6)
    robot = RobotModel.from_urdf(urdf)
    reference = Reference(urdf, robot)
    x = states(robot, seed)
    slopes, q, step = robot.origin_slopes(*x), [v.numpy() for v in x], 1e-4
    compared = 0
    for j, name in enumerate(robot.joint_names):
        if reference.model.parents[reference.model.getJointId(name)] == 0:
            continue  # its parent link may be turned against the root, whose axes are meant then
        for k, direction in enumerate(np.eye(6)):
            ahead, behind = (
                moved(reference, urdf, name, s * step * direction[:3], s * step * direction[3:]).rnea(*q)
                for s in (1, -1)
            )
            np.testing.assert_allclose(slopes[:, j, k].numpy(), (ahead - behind) / (2 * step), atol=1e-6)
            compared += 1
    assert compared >= 12


def test_batches_are_loops_and_keep_the_dtype() -> None:
    robot = RobotModel.from_urdf(random_urdf(3, 5))
    x = states(robot, 4, 2, 3)
    for function in (robot.torque_slopes, robot.origin_slopes):
        batched = function(*x)
        for a in range(2):
            for b in range(3):
                torch.testing.assert_close(batched[a, b], function(*(v[a, b] for v in x)))
        single = function(*(v.float() for v in x))
        assert single.dtype == torch.float32
        torch.testing.assert_close(single.double(), batched, rtol=1e-3, atol=1e-3)


def test_slopes_are_differentiable() -> None:
    robot = RobotModel.from_urdf(random_urdf(5, 3))
    x = [v.requires_grad_() for v in states(robot, 1)]
    pi = robot.pi.clone().requires_grad_()
    assert gradcheck(robot.torque_slopes, (*x, pi))
    assert gradcheck(robot.origin_slopes, (*x, pi))
