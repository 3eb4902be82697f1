"""Limits: taken from the URDF or given instead, and refused in words that say what to do."""

from __future__ import annotations

import math
import re
from typing import Any

import numpy as np
import pytest
import torch
from excitation.arms import arm_urdf, pinocchio_origins, pinocchio_torque

import torchrbd
from torchrbd import OptionError, RigidBodyDynamics, RobotModel
from torchrbd.excitation.constraints import _RHO, Constraints
from torchrbd.excitation.limits import limits_of

URDF = arm_urdf()


def states(seed: int, count: int) -> list[torch.Tensor]:
    generator = torch.Generator().manual_seed(seed)
    return [torch.randn(count, 3, generator=generator, dtype=torch.float64) for _ in range(3)]


def constraints(urdf: str = URDF, **options: Any) -> Constraints:
    model = RigidBodyDynamics.from_urdf(urdf).requires_grad_(False)
    limits = limits_of(model.robot, **options)
    return Constraints(model.robot, limits, lambda t, q, qd, qdd: model(q, qd, qdd, t=t))


def test_what_is_given_stands_in_place_of_the_urdf() -> None:
    robot = RobotModel.from_urdf(URDF)
    limits = limits_of(
        robot,
        ranges={"joint1": (0.0, 1.0), "joint3": (0.3, 0.3)},
        velocities={"joint2": 0.7},
        efforts={"joint1": 5.0},
        margin=0.2,
        speed=0.5,
    )
    assert limits.moving == [0, 1]
    assert limits.held() == {2: 0.3}
    assert limits.middle.tolist() == pytest.approx([0.5, 0.0, 0.3])
    assert limits.half.tolist() == pytest.approx([0.4, 0.8 * 1.4, 0.0])
    assert limits.fastest.tolist()[:2] == pytest.approx([0.8 * 0.5 * 2.0, 0.8 * 0.5 * 0.7])
    assert limits.strongest.tolist() == pytest.approx([4.0, 48.0, 16.0])


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"joints": ["elbow"]}, "joints: robot 'arm' has no joint 'elbow'; its joints are joint1, joint2, joint3"),
        ({"ranges": {"elbow": (0, 1)}}, "ranges: robot 'arm' has no joint 'elbow'"),
        ({"ranges": {"joint1": (1.0, 0.0)}}, "range of 'joint1' is 1 to 0; expected two numbers, the lower one first"),
        ({"ranges": {"joint1": (0.0, math.inf)}}, "range of 'joint1' is 0 to inf"),
        ({"velocities": {"joint1": 0.0}}, "greatest speed of 'joint1' is 0; expected a positive number"),
        ({"efforts": {"joint1": math.nan}}, "greatest torque of 'joint1' is nan; expected a positive number"),
        ({"margin": 1.0}, "margin is 1; expected a part between 0 and 1"),
        ({"speed": 0.0}, "speed is 0; expected a part between 0 and 1"),
        ({"speed": math.nan}, "speed is nan"),
        ({"box": {"u": (0, 1)}}, "box: there is no axis 'u'; expected one of x, y, z"),
        ({"box": {"z": (1.0, 1.0)}}, "box: z from 1 to 1 m holds nothing"),
        ({"joints": []}, "no joint of 'arm' moves"),
    ],
)
def test_limits_that_cannot_be_used_are_refused(options: dict[str, Any], words: str) -> None:
    with pytest.raises(OptionError, match=re.escape(words)):
        limits_of(RobotModel.from_urdf(URDF), **options)


def test_missing_limits_are_named_together_with_the_options_that_give_them() -> None:
    robot = RobotModel.from_urdf(arm_urdf(limits=False))
    with pytest.raises(OptionError) as refused:
        limits_of(robot)
    told = str(refused.value)
    for joint in robot.joint_names:
        assert f"joint '{joint}' has no lower and upper limit (--range {joint}=-3.1:3.1)" in told
        assert f"joint '{joint}' has no speed limit (--velocity {joint}=2)" in told
        assert f"joint '{joint}' has no torque limit (--effort {joint}=10)" in told
    limits = limits_of(
        robot, joints=["joint2"], ranges={"joint2": (-1, 1)}, velocities={"joint2": 1}, efforts={"joint2": 9}
    )
    assert limits.moving == [1]


def test_a_joint_without_an_actuator_is_told() -> None:
    robot = RobotModel.from_urdf(URDF.replace('effort="20.0"', 'effort="0"'))
    with pytest.raises(OptionError, match="joint 'joint3' has a torque limit of zero"):
        limits_of(robot, joints=["joint1"])


def test_uses_are_those_of_pinocchio_s_torque() -> None:
    one, (q, qd, qdd) = constraints(margin=0.1), states(1, 40)
    used = one.greatest(torch.arange(40.0, dtype=torch.float64), q, qd, qdd).numpy()
    tau = pinocchio_torque(URDF, *(x.numpy() for x in (q, qd, qdd)))
    expected = np.concatenate(
        (
            np.abs(q.numpy()).max(0) / (0.9 * np.array([2.5, 1.4, 2.2])),
            np.abs(qd.numpy()).max(0) / (0.9 * np.array([2.0, 2.0, 2.5])),
            np.abs(tau).max(0) / (0.9 * np.array([30.0, 60.0, 20.0])),
        )
    )
    np.testing.assert_allclose(used, expected, rtol=1e-9)
    assert one.labels[0] == "the range of joint1"
    assert one.labels[-1] == "the torque of joint3"


def test_the_box_holds_the_origins_of_all_links_that_move_tools_included() -> None:
    one, (q, qd, qdd) = constraints(box={"z": (0.2, math.inf), "x": (-0.3, 0.9)}), states(2, 30)
    links = tuple(point.link for point in one.points)
    assert links == ("link3", "tool")
    p = pinocchio_origins(URDF, q.numpy(), links)
    np.testing.assert_allclose(one.positions(q).numpy(), p, rtol=0, atol=1e-12)
    used = one.greatest(torch.arange(30.0, dtype=torch.float64), q, qd, qdd).numpy()[-3:]
    beyond = np.array([(-0.3 - p[..., 0]).max(), (p[..., 0] - 0.9).max(), (0.2 - p[..., 2]).max()])
    np.testing.assert_allclose(used, 1.0 + (beyond + 1e-3) / 0.25, rtol=1e-9)


def test_a_box_around_what_does_not_move_asks_for_nothing() -> None:
    """The first joint turns the others' links about its own axis."""
    one = constraints(joints=["joint1"], box={"z": (9.0, math.inf)})
    assert one.points == ()
    assert all("box" not in label for label in one.labels)


def test_the_smooth_bound_lies_just_above_and_its_slopes_are_right() -> None:
    one, (q, qd, qdd) = constraints(box={"z": (0.2, math.inf)}), states(3, 12)
    t = torch.arange(12.0, dtype=torch.float64)
    least, bound = one.greatest(t, q, qd, qdd), one.smooth(t, q, qd, qdd)
    assert (bound >= least).all()
    assert (bound <= least + math.log(24) / _RHO).all()
    inputs = [x.requires_grad_() for x in (q, qd, qdd)]
    assert torch.autograd.gradcheck(lambda *x: one.smooth(t, *x), inputs, eps=1e-7, atol=1e-4, rtol=1e-4)


def test_a_joint_that_stands_still_has_no_range_to_use_but_a_torque() -> None:
    one = constraints(joints=["joint2", "joint3"])
    assert [label for label in one.labels if "joint1" in label] == ["the torque of joint1"]
    assert torchrbd.excite(URDF, joints=["joint2", "joint3"], starts=1).uses[0].speed == 0.0


def test_limits_of_the_urdf_that_are_inverted_are_refused() -> None:
    """A joint that stands still for that would go unnoticed."""
    robot = RobotModel.from_urdf(URDF.replace('lower="-1.4" upper="1.4"', 'lower="1.4" upper="-1.4"'))
    with pytest.raises(OptionError, match=r"joint2' has its lower limit above the upper one \(--range joint2=-3.1"):
        limits_of(robot)
    assert limits_of(robot, ranges={"joint2": (-1.0, 1.0)}).moving == [0, 1, 2]


FOLLOWER = """<link name="finger"><inertial><mass value="0.2"/>
  <inertia ixx="1e-3" iyy="1e-3" izz="1e-3" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="follower" type="revolute"><parent link="link3"/><child link="finger"/><origin xyz="0 0 0.3"/>
  <axis xyz="0 1 0"/><limit lower="-1" upper="1" velocity="2" effort="9"/>
  <mimic joint="joint3" multiplier="-2" offset="0.5"/></joint></robot>"""


def test_a_joint_that_follows_another_keeps_its_own_limits() -> None:
    """-1 <= -2 q + 0.5 <= 1, and its speed is twice that of the joint that it follows."""
    robot = RobotModel.from_urdf(URDF.replace("</robot>", FOLLOWER))
    limits = limits_of(robot)
    assert (float(limits.lower[2]), float(limits.upper[2])) == pytest.approx((-0.25, 0.75))
    assert float(limits.velocity[2]) == pytest.approx(1.0)
    given = limits_of(robot, ranges={"joint3": (-2.0, 2.0)}, velocities={"joint3": 2.0})
    assert (float(given.upper[2]), float(given.velocity[2])) == (2.0, 2.0)


PAIR = """<robot name="pair"><link name="b"/>
  <link name="l1"><inertial><origin xyz="0 0 .1"/><mass value="2"/>
    <inertia ixx=".02" iyy=".02" izz=".01" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="l2"><inertial><origin xyz="0 0 .1"/><mass value="1"/>
    <inertia ixx=".01" iyy=".01" izz=".01" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="j1" type="revolute"><parent link="b"/><child link="l1"/><axis xyz="0 1 0"/>
    <limit lower="-1" upper="1" velocity="2" effort="50"/></joint>
  <joint name="j2" type="revolute"><parent link="l1"/><child link="l2"/><origin xyz="0 0 .3"/><axis xyz="0 1 0"/>
    <limit lower="-{reach}" upper="{reach}" velocity="2" effort="50"/></joint></robot>"""


@pytest.mark.parametrize("reach", ["1e-3", "1e-6", "1e-12"])
def test_a_joint_of_tiny_range_moves_in_it(reach: str) -> None:
    """However fast it might be."""
    used = torchrbd.excite(PAIR.replace("{reach}", reach), starts=1).uses[1]
    assert used.range_used <= 0.9 + 1e-9
    assert used.high - used.low > float(reach)
