"""A model as MJCF, against MuJoCo: the torques of mj_inverse and the motion of mj_forward are the model's."""

from __future__ import annotations

import sys

import numpy as np
import pytest
import torch
from effects.sites import site_of
from effects.test_effects import sizes
from lxml import etree
from robot.random_robots import random_states, random_urdf

import torchrbd
from torchrbd import RigidBodyDynamics, RobotModel
from torchrbd.effects import Site, Term, effect, known_effects
from torchrbd.errors import OptionError, PhysicalError
from torchrbd.robot import PARAMETERS

mujoco = pytest.importorskip("mujoco")
URDF = random_urdf(5, 4, massless=0.0)
ARM = random_urdf(5, 3, kinds=("revolute",), branching=0.0, massless=0.0)


def term(name: str, site: Site, **given: float) -> Term:
    w, shape = effect(name).coefficients(given)
    return Term(effect(name), site, torch.tensor(w, dtype=torch.float64), shape)


def arm(*terms: Term, urdf: str = ARM, gravity: tuple[float, ...] = (0.0, 0.0, -9.81)) -> RigidBodyDynamics:
    return RigidBodyDynamics(RobotModel.from_urdf(urdf, gravity=gravity), terms=terms)


def compiled(model: RigidBodyDynamics) -> mujoco.MjModel:
    machine = mujoco.MjModel.from_xml_string(torchrbd.to_mjcf(model).decode())
    machine.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_LIMIT  # states are drawn from beyond them
    return machine


def mimicked(urdf: str) -> dict[str, tuple[str, float, float]]:
    """Return what each mimic joint follows, with multiplier and offset; nothing follows a mimic joint here."""
    tags = etree.fromstring(urdf.encode()).iterfind("joint/mimic")
    return {
        m.getparent().get("name"): (m.get("joint"), *(float(m.get(k)) for k in ("multiplier", "offset"))) for m in tags
    }


def by_mujoco(model: RigidBodyDynamics, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray, urdf: str) -> np.ndarray:
    """Return the torques (N, n) that the file's actuators are asked for."""
    machine, names = compiled(model), model.robot.joint_names
    data, found = mujoco.MjData(machine), []
    follows = mimicked(urdf)
    for row in zip(q, qd, qdd, strict=True):
        for joint in (machine.joint(k) for k in range(machine.njnt)):
            driver, factor, offset = follows.get(joint.name, (joint.name, 1.0, 0.0))
            at, of = joint.dofadr[0], names.index(driver)
            data.qpos[at], data.qvel[at], data.qacc[at] = (factor * x[of] for x in row)
            data.qpos[at] += offset
        mujoco.mj_inverse(machine, data)
        tau = data.qfrc_inverse[[machine.joint(name).dofadr[0] for name in names]].copy()
        for joint, (driver, factor, _) in follows.items():
            tau[names.index(driver)] += factor * data.qfrc_inverse[machine.joint(joint).dofadr[0]]
        actuators = [machine.actuator(name) for name in names]
        found.append([(f - a.biasprm[0]) / a.gainprm[0] for f, a in zip(tau, actuators, strict=True)])
    return np.array(found)


def states(model: RigidBodyDynamics, seed: int = 3, samples: int = 20) -> list[np.ndarray]:
    """Return q, qd, qdd (N, n) of joints, and motors, that all move: around rest MuJoCo's dry friction yields."""
    q, qd, qdd = random_states(seed, samples, model.robot.n_dof)
    qd = qd + 0.5 * np.sign(qd)
    motors = [(t.site, t.shape["ratio"]) for t in model.terms if t.effect.id == "coupled_motor"]
    moving = np.all([abs(qd[:, s.joint] + r * qd[:, s.other]) > 0.3 for s, r in motors], axis=0)
    return [x[moving] if motors else x for x in (q, qd, qdd)]


def assert_same(model: RigidBodyDynamics, urdf: str = ARM, seed: int = 3, rtol: float = 1e-9) -> None:
    given = states(model, seed)
    tau = model(*map(torch.from_numpy, given)).detach().numpy()
    np.testing.assert_allclose(by_mujoco(model, *given, urdf), tau, rtol=0, atol=rtol * np.abs(tau).max())


def ordinary(robot: RobotModel, seed: int) -> list[Term]:
    """Return friction, a rotor and a spring at some joints, some of them twice."""
    rng, found = np.random.default_rng(seed), []
    for joint in rng.integers(robot.n_dof, size=2 * robot.n_dof).tolist():
        a, b = rng.uniform(0.1, 2.0, 2).tolist()
        found += [
            [term("viscous_friction", Site(joint), viscous=a)],
            [term("rotor_inertia", Site(joint), rotor_inertia=a)],
            [term("joint_spring", Site(joint), stiffness=a, rest_position=b)],
            [term("quadratic_drag", Site(joint), drag=a)],
            [term("one_sided_spring", Site(joint), contact_position=a - b, side=np.sign(b - 1), stiffness=a)],
        ][rng.integers(5)]
    return found


@pytest.mark.parametrize("seed", range(25))
def test_random_robots(seed: int) -> None:
    """Slides, turning and fixed joints, mimic joints, massless links, gravity along anything, and ordinary terms."""
    urdf = random_urdf(seed, 1 + seed % 8, massless=0.2, mimic=0.3)
    robot = RobotModel.from_urdf(urdf, gravity=np.random.default_rng(seed).normal(size=3).tolist())
    assert_same(RigidBodyDynamics(robot, terms=ordinary(robot, seed)), urdf, seed)


@pytest.mark.parametrize("seed", range(5))
def test_dry_friction_in_motion(seed: int) -> None:
    model = arm(
        term("coulomb_friction", Site(0), coulomb=0.8),
        term("coulomb_friction", Site(1), coulomb=0.5),
        term("asymmetric_coulomb_friction", Site(1), coulomb_plus=1.0, coulomb_minus=0.4),
    )
    assert_same(model, seed=seed)
    assert any(
        sentence.startswith("dry friction near rest, of joint1, joint2") for sentence in torchrbd.not_exported(model)
    )


def test_in_fast_motion_friction_that_is_there_in_part_is_whole() -> None:
    """Far above the Stribeck speed, and after bristles have slipped."""
    stribeck = term("stribeck_friction", Site(0), coulomb=0.8, static=1.5, stribeck_speed=0.05)
    bristles = term("presliding_hysteresis", Site(1), coulomb=0.5, distance=0.01)
    dry = [term("coulomb_friction", Site(j), coulomb=c) for j, c in ((0, 0.8), (1, 0.5))]
    given = states(arm())
    tau = arm(*dry)(*map(torch.from_numpy, given)).detach().numpy()
    np.testing.assert_allclose(by_mujoco(arm(stribeck, bristles), *given, ARM), tau, rtol=0, atol=1e-9)
    told = torchrbd.not_exported(arm(stribeck, bristles))
    assert any("frictionloss is friction in motion" in s for s in told)
    assert any('MJCF: <dcmotor lugre="50.0 0.0 0.5 0.5 1.0">' in s for s in told)


def test_a_payload_that_is_always_there_is_part_of_its_link() -> None:
    inertia = dict(zip(PARAMETERS[4:], (0.22, 0.03, 0.18, -0.04, 0.09, 0.1), strict=True))
    assert_same(arm(term("payload", Site(body=2), mass=1.5, x=0.1, y=-0.2, z=0.3, **inertia)))


def test_friction_is_that_of_a_torque_with_another_gain() -> None:
    assert_same(
        arm(
            term("torque_scale", Site(1), gain=1.25),
            term("torque_offset", Site(1), offset=0.7),
            term("viscous_friction", Site(1), viscous=0.3),
            term("coulomb_friction", Site(1), coulomb=0.5),
            term("rotor_inertia", Site(1), rotor_inertia=0.2),
            term("joint_spring", Site(1), stiffness=3.0, rest_position=0.4),
            term("one_sided_spring", Site(1), contact_position=0.1, side=1.0, stiffness=5.0),
            term("joint_coupling", Site(1, other=2), stiffness=1.25 * 2.0, offset=0.4),
            term("joint_coupling", Site(2, other=1), stiffness=2.0, offset=-0.1),
        )
    )


@pytest.mark.parametrize("k", [2.0, -2.0])
def test_couplings_from_both_sides_are_tendons(k: float) -> None:
    model = arm(
        term("joint_coupling", Site(0, other=2), stiffness=k, offset=0.3),
        term("joint_coupling", Site(2, other=0), stiffness=k, offset=-0.5),
        term("velocity_coupling", Site(2, other=1), viscous=0.7 * k),
        term("velocity_coupling", Site(1, other=2), viscous=0.7 * k),
        term("joint_spring", Site(0), stiffness=2.0, rest_position=0.3),  # just what the tendon adds
        *(term("viscous_friction", Site(j), viscous=1.4) for j in (1, 2)),
    )
    assert_same(model)
    assert not any("coupling" in sentence for sentence in torchrbd.not_exported(model))


def test_a_coupling_that_joints_do_not_damp_is_not_in_the_file() -> None:
    """A tendon acts on each joint alone, too; less damping than that would be a negative one."""
    pairs = [term("velocity_coupling", Site(*pair), viscous=0.7) for pair in ((2, 1), (1, 2))]
    model = arm(*pairs, term("viscous_friction", Site(1), viscous=0.5))
    text = torchrbd.to_mjcf(model).decode()
    assert 'damping="-' not in text
    assert "<fixed" not in text
    assert any("by their speeds (0.7)" in sentence for sentence in torchrbd.not_exported(model))


def test_a_motor_of_two_joints_is_a_tendon() -> None:
    motor = {"viscous": 0.4, "coulomb": 0.5, "rotor_inertia": 0.2, "ratio": -0.5}
    both = [term("torque_scale", Site(j), gain=1.25) for j in (1, 2)]
    assert_same(arm(term("coupled_motor", Site(2, other=1), **motor)))
    assert_same(arm(term("coupled_motor", Site(2, other=1), **motor), *both))
    uneven = arm(term("coupled_motor", Site(2, other=1), **motor), *both[:1])
    assert any("divided by the gain" in sentence for sentence in torchrbd.not_exported(uneven))


def test_a_coupling_from_one_side_acts_on_the_other_joint_too_and_is_told() -> None:
    model = arm(term("joint_coupling", Site(0, other=2), stiffness=-2.0, offset=0.3))
    given = states(model)
    apart = by_mujoco(model, *given, ARM) - model(*map(torch.from_numpy, given)).detach().numpy()
    np.testing.assert_allclose(apart[:, :2], 0.0, atol=1e-9)
    np.testing.assert_allclose(apart[:, 2], -2.0 * given[0][:, 0], atol=1e-9)
    (sentence,) = [s for s in torchrbd.not_exported(model) if "coupling" in s]
    assert sentence.endswith("the model has -2 at joint1 and 0 at joint3")


def test_the_file_moves_as_the_model() -> None:
    """Asked for the model's torque, MuJoCo's robot accelerates as the model's does."""
    model = arm(
        term("torque_scale", Site(0), gain=0.8),
        term("torque_offset", Site(0), offset=0.7),
        term("viscous_friction", Site(0), viscous=0.3),
        term("rotor_inertia", Site(1), rotor_inertia=0.2),
        term("joint_spring", Site(2), stiffness=3.0, rest_position=0.4),
    )
    machine, (q, qd, qdd) = compiled(model), states(model)
    machine.jnt_actfrclimited[:] = 0
    data = mujoco.MjData(machine)
    for row in zip(q, qd, qdd, strict=True):
        data.qpos[:], data.qvel[:] = row[:2]
        data.ctrl[:] = model(*map(torch.from_numpy, row)).detach().numpy()
        mujoco.mj_forward(machine, data)
        np.testing.assert_allclose(data.qacc, row[2], rtol=1e-8, atol=1e-8)


def test_mimic_joints_stay_with_their_drivers() -> None:
    urdf = random_urdf(11, 4, kinds=("revolute",), massless=0.0, mimic=0.9)
    model = RigidBodyDynamics.from_urdf(urdf)
    machine, follows = compiled(model), mimicked(urdf)
    data = mujoco.MjData(machine)
    for joint, (driver, factor, offset) in follows.items():
        data.joint(joint).qpos = factor * data.joint(driver).qpos + offset
    data.ctrl[:] = 20.0
    for _ in range(100):
        mujoco.mj_step(machine, data)
    assert len(follows) > 1
    for joint, (driver, factor, offset) in follows.items():
        moved = data.joint(driver).qpos[0]
        assert abs(moved) > 0.01
        assert data.joint(joint).qpos[0] == pytest.approx(factor * moved + offset, abs=0.02 * abs(moved))


SMALL = {"base_tilt": 1e-4, "encoder_offset": 1e-4, "geometry_error": 1e-4}


@pytest.mark.parametrize("name", sorted(known_effects()))
def test_every_effect_is_in_the_file_or_told(name: str) -> None:
    """What no sentence names has the model's torque."""
    given = {key: value * SMALL.get(name, 1.0) for key, value in sizes(effect(name)).items()}
    one = term(name, site_of(effect(name)), **given)
    model = arm(one)
    told = [
        sentence
        for sentence in torchrbd.not_exported(model)
        if effect(name).words in sentence or "coupling" in sentence
    ]
    assert len(told) <= 1
    assert told or effect(name).mjcf(given)
    if not told and name not in ("time_delay", "actuator_lag"):
        assert_same(model, rtol=1e-6 if name in SMALL else 1e-9)
        assert torchrbd.to_mjcf(model) != torchrbd.to_mjcf(arm())


@pytest.mark.parametrize("gravity", [(0.0, 0.0, -9.81), (0.0, 9.81, 0.0), (-9.81, 0.0, 0.0)])
def test_a_base_is_tilted_about_the_axes_beside_gravity(gravity: tuple[float, ...]) -> None:
    model = arm(term("base_tilt", Site(), tilt_x=2e-4, tilt_y=-1e-4), gravity=gravity)
    given = states(model)
    tilt = (model(*map(torch.from_numpy, given)) - arm(gravity=gravity)(*map(torch.from_numpy, given))).detach().numpy()
    found = by_mujoco(model, *given, ARM) - by_mujoco(arm(gravity=gravity), *given, ARM)
    np.testing.assert_allclose(found, tilt, atol=2e-3 * np.abs(tilt).max())


def test_what_acts_for_a_time_is_told_and_not_written() -> None:
    one = term("joint_spring", Site(0, recordings=("cold.csv",)), stiffness=3.0, rest_position=0.4)
    assert_same(arm(one))
    place = "joint spring at joint1 in cold.csv (stiffness 3 N m/rad, rest_position 0.4 rad)"
    assert torchrbd.not_exported(arm(one))[0].startswith(place)


def test_comments_say_what_the_function_says() -> None:
    model = arm(term("power_law_friction", Site(0), friction=1.0, exponent=0.5))
    comments = [node.text.strip() for node in etree.fromstring(torchrbd.to_mjcf(model)).iter(etree.Comment)]
    assert comments[1:] == list(torchrbd.not_exported(model))
    assert comments[1].startswith("power-law friction at joint1 (friction 1 N m (s/rad)^a, exponent 0.5): MJCF has")


def test_delays_and_lags_are_in_the_actuators() -> None:
    machine = compiled(
        arm(
            term("time_delay", Site(1), delay=-0.02, step=-0.015),
            term("time_delay", Site(), delay=0.01, step=0.015),
            term("actuator_lag", Site(), time_constant=0.03),
            term("actuator_lag", Site(2), time_constant=0.01),
        )
    )
    assert machine.actuator_delay.tolist() == [0.0, 0.02, 0.0]
    np.testing.assert_allclose(machine.actuator_dynprm[:, 0], [0.03, 0.03, 0.04])
    assert machine.sensor_delay.tolist() == [0.01] * 3


LINKS = """<robot name="bare"><link name="world"/>{links}
<joint name="a" type="revolute"><parent link="world"/><child link="one"/><axis xyz="0 1 0"/>
<limit lower="-1" upper="1" effort="7" velocity="2"/></joint>
<joint name="b" type="continuous"><parent link="one"/><child link="two"/><axis xyz="1 0 0"/>
<origin xyz="0 0 0.3"/></joint></robot>"""


def bare(one: str, two: str) -> str:
    tag = '<link name="{}"><inertial><origin xyz="0 0.1 0.2"/><mass value="{}"/><inertia {}/></inertial></link>'
    entries = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
    links = []
    for name, text in (("one", one), ("two", two)):
        mass, *moments = text.split()
        numbers = " ".join(f'{k}="{v}"' for k, v in zip(entries, [*moments, 0, 0, 0], strict=True))
        links.append(tag.format(name, mass, numbers))
    return LINKS.format(links="".join(links))


@pytest.mark.parametrize(
    ("one", "two", "words"),
    [
        ("0 0 0 0", "2 .1 .1 .1", "one moves and has no mass"),
        ("1 .1 .1 .1", "2 0 0 0", "two is a point or a line"),
        ("1 .1 .1 .1", "2 .1 .1 .2", "two is a point or a line"),
    ],
)
def test_what_mujoco_refuses_gets_next_to_nothing_and_is_told(one: str, two: str, words: str) -> None:
    urdf = bare(one, two)
    model = arm(urdf=urdf)
    assert_same(model, urdf)
    assert any(sentence.startswith(words) for sentence in torchrbd.not_exported(model))


@pytest.mark.parametrize("two", ["2 .1 .1 .3", "2 .1 .1 -.1", "0 .1 .1 .1"])
def test_what_no_body_can_have_is_refused_with_the_link(two: str) -> None:
    with pytest.raises(PhysicalError, match=r"two: .* correct <inertial> in the URDF, or re-fit the link"):
        torchrbd.to_mjcf(arm(urdf=bare("1 .1 .1 .1", two)))


def test_names_limits_and_gravity() -> None:
    machine = mujoco.MjModel.from_xml_string(
        torchrbd.to_mjcf(arm(urdf=bare("1 .1 .1 .1", "2 .1 .1 .1"), gravity=(1.0, 2.0, 3.0))).decode()
    )
    assert [machine.body(k).name for k in range(machine.nbody)] == ["world", "world_link", "one", "two"]
    assert machine.jnt_limited.tolist() == [1, 0]
    assert machine.jnt_range[0].tolist() == [-1.0, 1.0]
    assert machine.jnt_actfrcrange[0].tolist() == [-7.0, 7.0]
    assert machine.opt.gravity.tolist() == [1.0, 2.0, 3.0]


def test_numbers_that_are_not_finite_are_told() -> None:
    model = arm(term("encoder_offset", Site(1), offset=float("nan")))
    told = torchrbd.not_exported(model)
    assert any("encoder offset at joint2" in s and s.endswith("not finite") for s in told)
    compiled(model)


def test_a_robot_without_urdf_can_be_written_and_without_mujoco_too(monkeypatch: pytest.MonkeyPatch) -> None:
    robot = RobotModel.from_urdf(ARM)
    inertials = {link.name: link.pi for links in robot.folded.values() for link in links}
    assert_same(RigidBodyDynamics(RobotModel.from_chain(robot.to_chain(), inertials)))
    monkeypatch.setitem(sys.modules, "mujoco", None)
    assert b"<mujoco" in torchrbd.to_mjcf(arm())


def test_urdf_lacks_more() -> None:
    model = arm(
        term("viscous_friction", Site(0), viscous=0.3),
        term("rotor_inertia", Site(1), rotor_inertia=0.2),
        gravity=(0.0, 9.81, 0.0),
    )
    rotor, gravity = torchrbd.not_exported(model, "urdf")
    assert rotor == "rotor inertia (armature) at joint2 (rotor_inertia 0.2 N m s^2/rad): URDF has no word for it"
    assert gravity.startswith("gravity, which is 0 9.81 0 m/s^2 in the base's axes")
    with pytest.raises(OptionError, match="there is no format 'sdf'; expected urdf, mjcf, isaaclab"):
        torchrbd.not_exported(model, "sdf")


@pytest.mark.parametrize(
    ("limit", "words"),
    [
        (
            '<limit lower="0" upper="0" velocity="2" effort="5"/>',
            "limits of joint1, whose lower end",
        ),
        (
            '<limit lower="1" upper="-1" velocity="2" effort="5"/>',
            "limits of joint1, whose lower end",
        ),
        ('<limit lower="-1" upper="1" velocity="2" effort="0"/>', "effort limits of joint1, which are not above zero"),
    ],
)
def test_limits_that_mujoco_does_not_take_are_told(limit: str, words: str) -> None:
    urdf = (
        '<robot name="one"><link name="base"/><link name="arm"><inertial><origin xyz="0 0 .1"/><mass value="1"/>'
        '<inertia ixx=".02" iyy=".02" izz=".01" ixy="0" ixz="0" iyz="0"/></inertial></link><joint name="joint1" '
        f'type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 1 0"/>{limit}</joint></robot>'
    )
    model = arm(urdf=urdf)
    assert any(one.startswith(words) for one in torchrbd.export.not_exported(model))
    assert compiled(model).nv == 1
