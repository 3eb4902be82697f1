"""What is written is the model that was fitted, and nothing else of the file changes."""

from pathlib import Path

import pytest
import torch
from lxml import etree
from robot.random_robots import random_urdf

import torchrbd
from torchrbd import RigidBodyDynamics, RobotModel
from torchrbd.effects import Site, Term, effect
from torchrbd.errors import InputError, PhysicalError, RobotError
from torchrbd.export import load_model, save_model, to_urdf
from torchrbd.export.simulators import written

URDF = """<?xml version="1.0"?>
<!-- kept -->
<robot name="arm">
  <link name="base"/>
  <link name="upper"><inertial><origin xyz="0 0 0.2"/><mass value="3"/>
    <inertia ixx="0.05" iyy="0.05" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial><visual name="shape"/></link>
  <link name="tool"><inertial><origin xyz="0 0.1 0" rpy="0.3 0 0"/><mass value="1"/>
    <inertia ixx="0.02" iyy="0.03" izz="0.02" ixy="0.001" ixz="0" iyz="0"/></inertial></link>
  <link name="frame"/>
  <joint name="swing" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>
    <limit lower="-1" upper="1" effort="5" velocity="2"/><dynamics damping="0.1"/></joint>
  <joint name="bolt" type="fixed"><parent link="upper"/><child link="tool"/>
    <origin xyz="0 0 0.5" rpy="0 0.4 0"/></joint>
  <joint name="mark" type="fixed"><parent link="tool"/><child link="frame"/></joint>
  <gazebo reference="upper"/>
</robot>
"""


def changed(model: RigidBodyDynamics, size: float = 0.05, seed: int = 0) -> RigidBodyDynamics:
    generator = torch.Generator().manual_seed(seed)
    with torch.no_grad():
        model.raw_inertia += size * torch.randn(model.raw_inertia.shape, generator=generator, dtype=torch.float64)
    return model


def test_round_trip_through_urdf() -> None:
    model = changed(RigidBodyDynamics.from_urdf(URDF))
    again = RigidBodyDynamics.from_urdf(to_urdf(model))
    torch.testing.assert_close(again.pi, model.pi, rtol=1e-12, atol=1e-14)
    q, qd, qdd = torch.randn(3, 5, 1, dtype=torch.float64)
    torch.testing.assert_close(again(q, qd, qdd), model(q, qd, qdd), rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_round_trip_of_random_trees(seed: int) -> None:
    model = changed(RigidBodyDynamics.from_urdf(random_urdf(seed, 6)), seed=seed)
    torch.testing.assert_close(RigidBodyDynamics.from_urdf(to_urdf(model)).pi, model.pi, rtol=1e-9, atol=1e-12)


def test_fixed_links_keep_their_own_inertia_and_the_rest_of_the_file_stays() -> None:
    text = to_urdf(changed(RigidBodyDynamics.from_urdf(URDF), 0.002))
    old, new = etree.fromstring(URDF.encode()), etree.fromstring(text)
    for path in (
        "link[@name='tool']/inertial/mass",
        "link[@name='tool']/inertial/inertia",
        "joint[@name='swing']/limit",
    ):
        assert dict(new.find(path).attrib) == dict(old.find(path).attrib)
    assert new.find("link[@name='frame']/inertial") is None
    assert new.find("gazebo") is not None
    assert new.find("link[@name='upper']/visual").get("name") == "shape"
    assert b"<!-- kept -->" in text


def test_an_impossible_rest_moves_into_the_moving_link() -> None:
    """A body lighter than the tool fixed to it: the tool's inertia cannot stay what it was."""
    robot = RobotModel.from_urdf(URDF)
    light = RigidBodyDynamics(robot, 0.1 * robot.pi)
    text = to_urdf(light)
    torch.testing.assert_close(RobotModel.from_urdf(text).pi, light.pi.detach(), rtol=1e-12, atol=1e-14)
    assert etree.fromstring(text).find("link[@name='tool']/inertial") is None


def test_friction_becomes_dynamics_and_other_terms_a_comment() -> None:
    robot = RobotModel.from_urdf(URDF)
    one = torch.ones(1, dtype=torch.float64)
    terms = [
        Term(effect("viscous_friction"), Site(0), 0.4 * one, {}),
        Term(effect("coulomb_friction"), Site(0), 0.7 * one, {}),
        Term(effect("rotor_inertia"), Site(0), 0.2 * one, {}),
        Term(effect("base_tilt"), Site(), torch.tensor([0.02, 0.0], dtype=torch.float64), {}),
    ]
    text = to_urdf(RigidBodyDynamics(robot, terms=terms))
    again = RobotModel.from_urdf(text)
    assert (float(again.damping[0]), float(again.friction[0])) == (pytest.approx(0.4), pytest.approx(0.7))
    assert b"rotor inertia (armature) at swing (rotor_inertia 0.2 N m s^2/rad): URDF has no word for it" in text
    assert b'MJCF: <joint armature="0.2">' in text
    assert b"tilt_x 0.02 rad" in text


PARTLY = [
    ("asymmetric_coulomb_friction", {"coulomb_plus": 0.9, "coulomb_minus": 0.4}, 0.65, "mean of both directions"),
    ("stribeck_friction", {"coulomb": 0.5, "static": 0.8, "stribeck_speed": 0.1}, 0.5, "in fast motion"),
    ("presliding_hysteresis", {"coulomb": 0.5, "distance": 0.01}, 0.5, "of sliding"),
    ("time_varying_friction", {"coulomb_end": 0.5, "coulomb_start": 0.8, "time_constant": 9.0}, 0.5, "settles to"),
    (
        "position_dependent_friction",
        {"centre": 0.1, "width": 0.2, "profile": 0.0, "coulomb": 0.5, "coulomb_at_centre": 0.7},
        0.5,
        "outside of the region",
    ),
]


def told(name: str, given: dict[str, float]) -> Term:
    w, shape = effect(name).coefficients(given)
    return Term(effect(name), Site(0), torch.tensor(w, dtype=torch.float64), shape)


@pytest.mark.parametrize(("name", "given", "friction", "words"), PARTLY, ids=[one[0] for one in PARTLY])
def test_coulomb_friction_that_another_law_contains(
    name: str, given: dict[str, float], friction: float, words: str
) -> None:
    """It adds to the rest of the joint's, and what is left out is told in the file and beside it."""
    terms = [told(name, given), told("coulomb_friction", {"coulomb": 0.1})]
    model = RigidBodyDynamics(RobotModel.from_urdf(URDF), terms=terms)
    text = to_urdf(model)
    assert float(RobotModel.from_urdf(text).friction[0]) == pytest.approx(friction + 0.1)
    (sentence,) = torchrbd.not_exported(model, "urdf")
    assert sentence.startswith(f"{effect(name).words} at swing")
    assert words in sentence
    (comment,) = etree.fromstring(text).iter(etree.Comment)
    assert comment.text.strip().startswith(f"torchrbd: {sentence}; MJCF: <")


def test_friction_that_the_model_has_no_more_does_not_remain() -> None:
    """Neither a value, nor an empty tag, nor that of a joint that follows; what else the tag says stays."""
    mimic = """<link name="finger"><inertial><mass value="1"/>
    <inertia ixx="0.02" iyy="0.03" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial></link>
    <joint name="follow" type="revolute"><parent link="upper"/><child link="finger"/><axis xyz="0 1 0"/>
    <limit lower="-1" upper="1" effort="5" velocity="2"/><mimic joint="swing"/>
    <dynamics damping="3" friction="4"/></joint></robot>"""
    had = URDF.replace('damping="0.1"', 'damping="0.1" friction="0.6" spring_stiffness="2"').replace("</robot>", mimic)
    robot = RobotModel.from_urdf(had)
    swing, follow = (f"joint[@name='{name}']/dynamics" for name in ("swing", "follow"))
    bare = etree.fromstring(to_urdf(RigidBodyDynamics(robot)))
    assert dict(bare.find(swing).attrib) == {"spring_stiffness": "2"}
    assert bare.find(follow) is None
    dry = etree.fromstring(to_urdf(RigidBodyDynamics(robot, terms=[told("coulomb_friction", {"coulomb": 0.2})])))
    assert dict(dry.find(swing).attrib) == {"spring_stiffness": "2", "friction": "0.2"}


@pytest.mark.parametrize(
    ("identifier", "parameter", "in_urdf", "in_mjcf"),
    [
        ("coulomb_friction", "coulomb", "friction", "frictionloss"),
        ("viscous_friction", "viscous", "damping", "damping"),
        ("rotor_inertia", "rotor_inertia", None, "armature"),
    ],
)
def test_what_would_drive_a_joint_is_refused(
    identifier: str, parameter: str, in_urdf: str | None, in_mjcf: str
) -> None:
    """A simulator gains energy by a negative coefficient; no file holds one."""
    model = RigidBodyDynamics(RobotModel.from_urdf(URDF), terms=[told(identifier, {parameter: -0.2})])
    for to, name in (("urdf", in_urdf), ("mjcf", in_mjcf)):
        if name is not None:
            with pytest.raises(PhysicalError, match=f"swing: {name} is -0.2.*Fit the term again"):
                written(model, to)
            with pytest.raises(PhysicalError, match=name):
                torchrbd.not_exported(model, to)


def test_friction_of_some_recordings_is_not_in_the_file() -> None:
    one = effect("coulomb_friction")
    cold = Term(one, Site(0, recordings=("cold.csv",)), torch.ones(1, dtype=torch.float64), {})
    model = RigidBodyDynamics(RobotModel.from_urdf(URDF), terms=[cold])
    assert etree.fromstring(to_urdf(model)).find("joint/dynamics") is None
    (sentence,) = torchrbd.not_exported(model, "urdf")
    assert sentence.startswith("Coulomb friction at swing in cold.csv")
    assert sentence.endswith("does not act always, and the file is of one condition")


def test_safetensors_round_trip(tmp_path: Path) -> None:
    robot = RobotModel.from_urdf(URDF, gravity=(0.0, 1.0, -9.7))
    stribeck = effect("stribeck_friction")
    w, shape = stribeck.coefficients({"coulomb": 0.5, "static": 0.8, "stribeck_speed": 0.1})
    term = Term(stribeck, Site(0), torch.tensor(w, dtype=torch.float64), shape)
    model = changed(RigidBodyDynamics(robot, terms=[term]))
    save_model(model, tmp_path / "model.safetensors")
    again = load_model(tmp_path / "model.safetensors")
    q, qd, qdd = torch.randn(3, 7, 1, dtype=torch.float64)
    assert torch.equal(again(q, qd, qdd), model(q, qd, qdd))
    assert again.robot.gravity.tolist() == [0.0, 1.0, -9.7]


def test_files_that_are_no_models(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"missing\.safetensors"):
        load_model(tmp_path / "missing.safetensors")
    (tmp_path / "text.safetensors").write_text("tau = Y pi")
    with pytest.raises(InputError, match=r"text\.safetensors"):
        load_model(tmp_path / "text.safetensors")


def test_a_robot_without_urdf_cannot_be_written(tmp_path: Path) -> None:
    robot = RobotModel.from_urdf(URDF)
    inertials = {link.name: link.pi for links in robot.folded.values() for link in links}
    bare = RobotModel.from_chain(robot.to_chain(), inertials)
    for write in (lambda m: to_urdf(m), lambda m: save_model(m, tmp_path / "m.safetensors")):
        with pytest.raises(RobotError, match="not made from a URDF"):
            write(RigidBodyDynamics(bare))


def test_public_names_exist() -> None:
    assert all(hasattr(torchrbd, name) for name in torchrbd.__all__)


MASSLESS = '<link name="upper"><inertial><mass value="0"/>'


def test_a_link_with_moments_and_no_mass_keeps_its_moments() -> None:
    """Nothing is divided by its mass."""
    upper = URDF[URDF.index('<link name="upper">') : URDF.index('<inertia ixx="0.05"')]
    urdf = URDF.replace(upper, MASSLESS).replace('<mass value="1"/>', '<mass value="0"/>')
    urdf = urdf.replace('ixx="0.02" iyy="0.03" izz="0.02" ixy="0.001"', 'ixx="0" iyy="0" izz="0" ixy="0"')
    model = RigidBodyDynamics.from_urdf(urdf)
    written = to_urdf(model)
    assert b"nan" not in written
    torch.testing.assert_close(RobotModel.from_urdf(written).pi, model.robot.pi)


def test_a_link_with_a_first_moment_and_no_mass_is_refused() -> None:
    robot = RobotModel.from_urdf(URDF)
    pi = robot.pi.clone()
    pi[0] = 1.0 - 1.0
    with pytest.raises(PhysicalError, match="has no mass and a centre of mass"):
        to_urdf(RigidBodyDynamics(robot, pi))
