"""What URDF says and how the reader takes it; what cannot be used and what the message is."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
import torch
from robot.random_robots import random_urdf

from torchrbd.errors import RobotError
from torchrbd.robot import RobotModel

INERTIAL = '<inertial><mass value="2"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>'
PLAIN = f"""<robot name="two">
  <link name="base"/><link name="a">{INERTIAL}</link><link name="b">{INERTIAL}</link>
  <joint name="j1" type="revolute"><parent link="base"/><child link="a"/><axis xyz="0 0 2"/>
    <limit lower="-1" upper="2" velocity="3" effort="4"/><dynamics damping="0.5" friction="0.25"/></joint>
  <joint name="j2" type="continuous"><parent link="a"/><child link="b"/><origin xyz="0 0 0.5"/></joint>
</robot>"""


def pi_of(urdf: str, link: str) -> list[float]:
    robot = RobotModel.from_urdf(urdf)
    return robot.pi.unflatten(0, (-1, 10))[robot.body_names.index(link)].tolist()


def test_names_and_numbers() -> None:
    robot = RobotModel.from_urdf(PLAIN)
    assert (robot.name, robot.joint_names, robot.body_names) == ("two", ("j1", "j2"), ("a", "b"))
    assert (robot.n_dof, robot.n_bodies, robot.n_params) == (2, 2, 20)
    assert robot.parameter_names[:2] == ("m_a", "mcx_a")
    assert robot.parameter_names[-1] == "Izz_b"
    assert robot.prismatic.tolist() == [False, False]
    assert robot.damping.tolist() == [0.5, 0.0]
    assert robot.friction.tolist() == [0.25, 0.0]
    assert robot.lower.tolist() == [-1, -math.inf]
    assert robot.upper.tolist() == [2, math.inf]
    assert robot.velocity.tolist() == [3, math.inf]
    assert robot.effort.tolist() == [4, math.inf]
    assert robot.gravity.tolist() == [0.0, 0.0, -9.81]
    assert robot.pi.dtype == torch.float64


def test_every_way_to_give_a_urdf(tmp_path: Path) -> None:
    text = '<?xml version="1.0" encoding="iso-8859-1"?>\n' + PLAIN.replace("two", "zwölf")
    path = tmp_path / "robot.urdf"
    path.write_bytes(text.encode("latin-1"))
    for source in (text, text.encode("latin-1"), path, str(path)):
        robot = RobotModel.from_urdf(source)
        assert robot.name == "zwölf"
        assert robot.urdf is not None
        assert RobotModel.from_urdf(robot.urdf).name == "zwölf"


def test_axis_is_normalised_and_x_by_default() -> None:
    half_turn = torch.tensor([math.pi, math.pi], dtype=torch.float64)
    rotation, _ = RobotModel.from_urdf(PLAIN).body_poses(half_turn)
    about_z, about_x = torch.diag(torch.tensor([-1.0, -1, 1])), torch.diag(torch.tensor([1.0, -1, -1]))
    torch.testing.assert_close(rotation, torch.stack((about_z, about_z @ about_x)).double())


def test_inertial_frame_is_moved_to_the_link() -> None:
    turned = PLAIN.replace(
        INERTIAL,
        '<inertial><origin xyz="0.1 0.2 0.3" rpy="0 0 1.5707963267948966"/><mass value="2"/>'
        '<inertia ixx="1" ixy="0" ixz="0" iyy="2" iyz="0" izz="2.5"/></inertial>',
    )
    expected = [2, 0.2, 0.4, 0.6, 2 + 0.26, -0.04, 1 + 0.2, -0.06, -0.12, 2.5 + 0.1]
    assert pi_of(turned, "a") == pytest.approx(expected, rel=1e-14)


def test_fixed_links_are_folded() -> None:
    urdf = PLAIN.replace("continuous", "fixed")
    assert RobotModel.from_urdf(urdf).body_names == ("a",)
    assert pi_of(urdf, "a") == [4, 0, 0, 1, 2.5, 0, 2.5, 0, 0, 2]


def test_unphysical_inertia_and_missing_inertial_are_allowed() -> None:
    assert pi_of(PLAIN.replace('ixx="1"', 'ixx="9"'), "b")[4] == 9
    assert pi_of(PLAIN.replace(f'<link name="b">{INERTIAL}</link>', '<link name="b"/>'), "b") == [0] * 10


def test_shapes_and_other_tags_are_ignored() -> None:
    extra = (
        '<link name="base"><visual><geometry><mesh filename="package://gone/x.stl"/></geometry></visual></link>'
        '<material name="grey"/><gazebo reference="a"><x/></gazebo><transmission name="t"/>'
    )
    assert RobotModel.from_urdf(PLAIN.replace('<link name="base"/>', extra)).n_dof == 2


def test_order_of_links_and_depth_first_numbers() -> None:
    for seed in range(10):
        robot = RobotModel.from_urdf(random_urdf(seed, 9, branching=0.6))
        spans = [robot.columns(j) for j in range(robot.n_dof)]
        assert all(int(c[-1] - c[0]) + 1 == len(c) and int(c[0]) == 10 * j for j, c in enumerate(spans))


J2 = '<joint name="j2" type="continuous"><parent link="a"/><child link="b"/>'
BAD = {
    "not xml": ("<robot", "<<robot", r"URDF text: not well-formed XML: "),
    "root tag": ("robot", "sdf", r"the root tag is <sdf>, expected <robot>"),
    "no robot name": ('<robot name="two">', "<robot>", r"line 1: <robot> has no name; add name="),
    "xacro": (
        '<link name="base"/>',
        '<xacro:arm xmlns:xacro="http://www.ros.org/wiki/xacro"/>',
        r"line 2: <xacro:arm> is left in the file; make a URDF of it: xacro FILE > expanded.urdf",
    ),
    "floating": ('"continuous"', '"floating"', r"joint 'j2' has type 'floating', expected one of revolute, continuous"),
    "planar": ('"continuous"', '"planar"', r"joint 'j2' has type 'planar'"),
    "no type": (' type="continuous"', "", r"joint 'j2' has type 'None'"),
    "no parent": ('<parent link="a"/>', "", r"joint 'j2' has no parent link; add <parent"),
    "unknown child": ('<child link="b"/>', '<child link="c"/>', r"joint 'j2' has child link 'c', which does not exist"),
    "loop": (
        "</robot>",
        '<joint name="j3" type="fixed"><parent link="base"/><child link="b"/></joint></robot>',
        r"link 'b' has two parents, through joints 'j2' and 'j3': closed loops",
    ),
    "circle": (
        "</robot>",
        '<joint name="j3" type="fixed"><parent link="b"/><child link="base"/></joint></robot>',
        r"links base, b, a form a closed loop; remove joint",
    ),
    "two roots": ("</robot>", '<link name="lost"/></robot>', r"2 links have no parent: base, lost; connect them"),
    "link twice": ("</robot>", '<link name="a"/></robot>', r"link name 'a' is used more than once"),
    "joint twice": ('name="j2"', 'name="j1"', r"joint name 'j1' is used more than once"),
    "no ixx": (' ixx="1"', "", r"link 'a': <inertia> lacks ixx; give all of ixx, ixy"),
    "no inertia": (
        '<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/>',
        "",
        r"link 'a': <inertial> has no <inertia>",
    ),
    "no mass value": ('<mass value="2"/>', "<mass/>", r"link 'a': <mass> lacks value"),
    "mass in words": ('value="2"', 'value="two"', r'link \'a\': <mass value="two">: expected a number'),
    "nan": ('izz="1"', 'izz="nan"', r'link \'a\': <inertia izz="nan">: expected a number'),
    "negative mass": ('value="2"', 'value="-2"', r"link 'a': mass is -2, expected 0 or more"),
    "short origin": ('xyz="0 0 0.5"', 'xyz="0 0"', r'joint \'j2\': <origin xyz="0 0">: expected 3 numbers'),
    "zero axis": ('xyz="0 0 2"', 'xyz="0 0 0"', r"joint 'j1': <axis xyz> is zero"),
    "limit in words": ('effort="4"', 'effort="strong"', r'joint \'j1\': <limit effort="strong">: expected a number'),
    "mimic of nothing": (J2, J2 + '<mimic joint="j9"/>', r"joint 'j2' mimics 'j9', which is no moving joint"),
    "mimic of itself": (J2, J2 + '<mimic joint="j2"/>', r"mimic joints follow each other in a circle, j2 -> j2"),
    "mimic without joint": (J2, J2 + '<mimic multiplier="2"/>', r"joint 'j2': <mimic> names no joint"),
}


@pytest.mark.parametrize(("old", "new", "message"), BAD.values(), ids=BAD)
def test_bad_urdf(old: str, new: str, message: str) -> None:
    assert old in PLAIN
    with pytest.raises(RobotError, match=message):
        RobotModel.from_urdf(PLAIN.replace(old, new))


def test_no_moving_joint() -> None:
    for urdf in (
        '<robot name="stone"><link name="base"/></robot>',
        PLAIN.replace("continuous", "fixed").replace("revolute", "fixed"),
    ):
        with pytest.raises(RobotError, match=r"has no moving joint"):
            RobotModel.from_urdf(urdf)
    with pytest.raises(RobotError, match="no links"):
        RobotModel.from_urdf('<robot name="nothing"/>')


def test_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(RobotError, match=r"gone\.urdf: cannot read the URDF file \(No such file or directory\)"):
        RobotModel.from_urdf(tmp_path / "gone.urdf")
    with pytest.raises(RobotError, match=r"Is a directory"):
        RobotModel.from_urdf(str(tmp_path))


def test_messages_name_the_file(tmp_path: Path) -> None:
    path = tmp_path / "arm.urdf"
    path.write_text(PLAIN.replace('value="2"', 'value="-2"'))
    with pytest.raises(RobotError, match=r"arm\.urdf: link 'a': mass is -2"):
        RobotModel.from_urdf(path)
