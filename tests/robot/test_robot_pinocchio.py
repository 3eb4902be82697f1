"""Against Pinocchio: random trees and the robots of example-robot-data, joints and bodies mapped by name."""

from __future__ import annotations

from importlib import metadata
from pathlib import Path

import numpy as np
import pytest
import torch
from robot.random_robots import random_states, random_urdf

from torchrbd.robot import RobotModel

pin = pytest.importorskip("pinocchio")
etree = pytest.importorskip("lxml.etree")

ARMS = {
    "panda_description/urdf/panda.urdf": True,  # a finger mimics the other
    "ur_description/urdf/ur5_robot.urdf": False,
    "kinova_description/robots/kinova.urdf": False,
    "xarm_description/urdf/xarm7.urdf": False,
    "z1_description/urdf/z1.urdf": False,
    "so_arm_description/urdf/so101.urdf": False,
    "talos_data/robots/talos_left_arm.urdf": False,
    "talos_data/robots/talos_reduced.urdf": True,
    "tiago_description/robots/tiago.urdf": True,
    "baxter_description/urdf/baxter.urdf": True,
    "centauro_description/urdf/centauro.urdf": False,
    "pr2_description/urdf/pr2.urdf": True,
    "double_pendulum_description/urdf/double_pendulum_continuous.urdf": False,
    "icub_description/robots/icub.urdf": False,
    "g1_description/urdf/g1_29dof_rev_1_0.urdf": False,
}
TOLERANCE = 1e-10


def _example(file: str) -> str:
    """The wheel of example-robot-data has no module, only files."""
    try:
        package = metadata.distribution("example-robot-data")
    except metadata.PackageNotFoundError:
        pytest.skip("example-robot-data is not installed")
    path = Path(str(package.locate_file("cmeel.prefix/share/example-robot-data/robots"))) / file
    return path.read_text() if path.exists() else pytest.skip(f"this example-robot-data has no {file}")


class Reference:
    """Pinocchio's answers in our joint order."""

    def __init__(self, urdf: str, robot: RobotModel, mimic: bool = False) -> None:
        self.model = pin.buildModelFromXML(urdf, mimic=mimic)
        self.data = self.model.createData()
        self.joints = [self.model.joints[self.model.getJointId(name)] for name in robot.joint_names]
        self.order = [joint.idx_v for joint in self.joints]

    def position(self, q: np.ndarray) -> np.ndarray:
        """Pinocchio's continuous joints have cosine and sine."""
        out = np.zeros(self.model.nq)
        for joint, value in zip(self.joints, q, strict=True):
            out[joint.idx_q : joint.idx_q + joint.nq] = value if joint.nq == 1 else (np.cos(value), np.sin(value))
        return out

    def velocity(self, qd: np.ndarray) -> np.ndarray:
        out = np.zeros(self.model.nv)
        out[self.order] = qd
        return out

    def rnea(self, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
        args = self.position(q), self.velocity(qd), self.velocity(qdd)
        return pin.rnea(self.model, self.data, *args)[self.order]


def close(actual: torch.Tensor, expected: np.ndarray) -> bool:
    return np.abs(actual.numpy() - expected).max() < TOLERANCE * max(np.abs(expected).max(), 1e-6)


@pytest.mark.parametrize("seed", range(50))
def test_random_tree(seed: int) -> None:
    urdf = random_urdf(seed, 1 + seed % 12)
    robot = RobotModel.from_urdf(urdf)
    reference = Reference(urdf, robot)
    model, data, order = reference.model, reference.data, reference.order
    q, qd, qdd = random_states(seed, 3, robot.n_dof)
    states = [torch.from_numpy(x) for x in (q, qd, qdd)]
    tau, Y, M = robot.inverse_dynamics(*states), robot.regressor(*states), robot.mass_matrix(states[0])
    forward = robot.forward_dynamics(states[0], states[1], states[2])
    bodies = [model.getJointId(name) - 1 for name in robot.joint_names]
    for k in range(3):
        args = reference.position(q[k]), reference.velocity(qd[k]), reference.velocity(qdd[k])
        assert close(tau[k], pin.rnea(model, data, *args)[order])
        columns = pin.computeJointTorqueRegressor(model, data, *args).reshape(model.nv, -1, 10)
        assert close(Y[k], columns[order][:, bodies].reshape(robot.n_dof, -1))
        upper = np.triu(pin.crba(model, data, args[0]))
        assert close(M[k], (upper + np.triu(upper, 1).T)[np.ix_(order, order)])
        assert close(forward[k], pin.aba(model, data, *args)[order])


@pytest.mark.parametrize("seed", range(10))
def test_mimic_is_the_free_tree_projected(seed: int) -> None:
    """With all joints free, `tau = T' tau_free(T q + offset, ...)`; T is read from the tags by this test."""
    urdf = random_urdf(seed, 8, mimic=0.5)
    root = etree.fromstring(urdf.encode())
    tags = {joint.get("name"): joint.find("mimic") for joint in root.findall("joint")}
    for joint in root.findall("joint"):
        if tags[joint.get("name")] is not None:
            joint.remove(joint.find("mimic"))
    robot = RobotModel.from_urdf(urdf)
    free = RobotModel.from_urdf(etree.tostring(root))
    T, offset = np.zeros((free.n_dof, robot.n_dof)), np.zeros(free.n_dof)
    for row, name in enumerate(free.joint_names):
        tag = tags[name]
        driver = name if tag is None else tag.get("joint")
        T[row, robot.joint_names.index(driver)] = 1.0 if tag is None else float(tag.get("multiplier"))
        offset[row] = 0.0 if tag is None else float(tag.get("offset"))
    reference = Reference(etree.tostring(root).decode(), free)
    q, qd, qdd = random_states(seed, robot.n_dof)
    expected = T.T @ reference.rnea(T @ q + offset, T @ qd, T @ qdd)
    states = [torch.from_numpy(x) for x in (q, qd, qdd)]
    assert close(robot.inverse_dynamics(*states), expected)
    assert close(robot.regressor(*states) @ robot.pi, expected)
    assert close(robot.mass_matrix(states[0]), T.T @ free.mass_matrix(torch.from_numpy(T @ q + offset)).numpy() @ T)


@pytest.mark.parametrize(("file", "mimic"), ARMS.items(), ids=[Path(file).stem for file in ARMS])
def test_known_robot(file: str, mimic: bool) -> None:
    urdf = _example(file)
    robot = RobotModel.from_urdf(urdf)
    reference = Reference(urdf, robot, mimic)
    q, qd, qdd = random_states(0, robot.n_dof)
    states = [torch.from_numpy(x) for x in (q, qd, qdd)]
    expected = reference.rnea(q, qd, qdd)
    assert close(robot.inverse_dynamics(*states), expected)
    assert close(robot.regressor(*states) @ robot.pi, expected)
