"""Exchange with pytorch-kinematics: chains in, chains out, forward kinematics as reference."""

from __future__ import annotations

import pytest
import pytorch_kinematics as pk
import torch
from robot.random_robots import random_states, random_urdf

from torchrbd.errors import RobotError
from torchrbd.robot import RobotModel


def pair(seed: int) -> tuple[RobotModel, RobotModel, pk.Chain]:
    """A robot, the same one made from pytorch-kinematics' own reading of the URDF, and that chain."""
    urdf = random_urdf(seed, 7)
    robot = RobotModel.from_urdf(urdf)
    chain = pk.build_chain_from_urdf(urdf.encode())
    inertials = {link.name: link.pi for links in robot.folded.values() for link in links}
    return robot, RobotModel.from_chain(chain, inertials), chain


@pytest.mark.parametrize("seed", range(5))
def test_poses_agree(seed: int) -> None:
    robot, _, theirs = pair(seed)
    q = torch.from_numpy(random_states(seed, 6, robot.n_dof)[0])
    rotations, origins = robot.body_poses(q)
    for chain, tolerance in ((theirs.to(dtype=torch.float64), 2e-6), (robot.to_chain(), 1e-12)):
        poses = chain.forward_kinematics({name: q[:, k] for k, name in enumerate(robot.joint_names)})
        for k, body in enumerate(robot.body_names):
            matrix = poses[body].get_matrix()
            torch.testing.assert_close(rotations[:, k], matrix[:, :3, :3], rtol=0, atol=tolerance)
            torch.testing.assert_close(origins[:, k], matrix[:, :3, 3], rtol=0, atol=tolerance)


@pytest.mark.parametrize("seed", range(5))
def test_dynamics_from_a_chain(seed: int) -> None:
    robot, other, chain = pair(seed)
    assert other.to_chain() is chain
    assert set(other.joint_names) == set(robot.joint_names)
    order = [other.joint_names.index(name) for name in robot.joint_names]
    x = [torch.from_numpy(y) for y in random_states(seed, 5, robot.n_dof)]
    back = [torch.empty_like(y) for y in x]
    for mine, y in zip(back, x, strict=True):
        mine[:, order] = y
    tau = robot.inverse_dynamics(*x)
    assert (other.inverse_dynamics(*back)[:, order] - tau).abs().max() < 1e-5 * tau.abs().max()


def test_round_trip_is_exact() -> None:
    robot, _, _ = pair(1)
    inertials = {link.name: link.pi for links in robot.folded.values() for link in links}
    again = RobotModel.from_chain(robot.to_chain(), inertials)
    assert again.joint_names == robot.joint_names
    assert torch.equal(again.lower, robot.lower)
    assert torch.equal(again.effort, robot.effort)
    x = [torch.from_numpy(y) for y in random_states(1, 5, robot.n_dof)]
    torch.testing.assert_close(again.inverse_dynamics(*x), robot.inverse_dynamics(*x), rtol=1e-12, atol=1e-12)


def test_dtype_of_the_chain() -> None:
    chain = pair(2)[0].to_chain(dtype=torch.float32)
    assert chain.dtype == torch.float32
    assert chain.forward_kinematics(torch.zeros(1, chain.n_joints))["link1"].get_matrix().dtype == torch.float32


def test_unknown_link_is_told() -> None:
    chain = pair(3)[2]
    with pytest.raises(RobotError, match=r"inertials name link 'linkX', which is not in the chain: base, "):
        RobotModel.from_chain(chain, {"linkX": torch.zeros(10)})
    with pytest.raises(RobotError, match=r"link 'link1' have shape \(9,\), expected \(10,\)"):
        RobotModel.from_chain(chain, {"link1": torch.zeros(9)})
