"""MJCF in: random trees against MuJoCo's inverse dynamics, what the file says of joints, and what is refused."""

from __future__ import annotations

import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest
import torch
from robot.random_robots import random_states
from watched import read_alone

import torchrbd
from torchrbd.errors import OptionError, RobotError
from torchrbd.model import RigidBodyDynamics
from torchrbd.robot import RobotModel


def numbers(rng: np.random.Generator, count: int, size: float = 1.0) -> str:
    return " ".join(repr(float(x)) for x in size * rng.standard_normal(count))


def random_mjcf(seed: int, bodies: int, *, drives: bool = True) -> str:
    """Return a random tree: anchors, references, several joints a body, geoms and inertials, welded bodies."""
    rng, joints = np.random.default_rng(seed), 0
    parents = [int(rng.integers(-1, k)) if k else -1 for k in range(bodies)]
    own = []
    for k in range(bodies):
        inside = ""
        for _ in range(int(rng.choice([0, 1, 1, 2])) if k else 1):
            kind = rng.choice(["hinge", "slide"])
            drive = (
                f'armature="{rng.uniform(0, 1)}" damping="{rng.uniform(0, 1)}" stiffness="{rng.uniform(0, 9)}" '
                f'springref="{rng.normal()}"'
            )
            inside += (
                f'<joint name="j{joints}" type="{kind}" axis="{numbers(rng, 3)}" pos="{numbers(rng, 3, 0.2)}" '
                f'ref="{rng.normal()}" {drive if drives else ""}/>'
            )
            joints += 1
        if rng.random() < 0.5:
            place = f'pos="{numbers(rng, 3, 0.1)}" quat="{numbers(rng, 4)}"'
            inside += f'<inertial mass="{rng.uniform(1, 3)}" {place} diaginertia=".02 .03 .04"/>'
        else:
            inside += f'<geom type="box" size=".1 .2 .3" pos="{numbers(rng, 3, 0.1)}" quat="{numbers(rng, 4)}"/>'
        own.append((f'<body name="b{k}" pos="{numbers(rng, 3)}" quat="{numbers(rng, 4)}">{inside}', parents[k]))

    def nested(at: int) -> str:
        return "".join(f"{inside}{nested(k)}</body>" for k, (inside, above) in enumerate(own) if above == at)

    head = f'<mujoco model="tree{seed}"><compiler angle="radian"/><option gravity="1 2 -9"/>'
    return f"{head}<worldbody>{nested(-1)}</worldbody></mujoco>"


def inverse(text: str, robot: RobotModel, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
    """Return MuJoCo's torques, joints in the robot's order."""
    model = mujoco.MjModel.from_xml_string(text)
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_LIMIT
    data = mujoco.MjData(model)
    at = [model.joint(name).dofadr[0] for name in robot.joint_names]
    data.qpos[at], data.qvel[at], data.qacc[at] = q, qd, qdd
    mujoco.mj_inverse(model, data)
    return data.qfrc_inverse[at]


@pytest.mark.parametrize("seed", range(20))
def test_random_trees(seed: int) -> None:
    """Rigid bodies alone, and with rotors, damping and springs; the gravity is the file's."""
    for drives in (False, True):
        text = random_mjcf(seed, 1 + seed % 7, drives=drives)
        robot = RobotModel.from_urdf(text.encode())
        q, qd, qdd = random_states(seed, robot.n_dof)
        wanted = inverse(text, robot, q, qd, qdd)
        states = [torch.from_numpy(x) for x in (q, qd, qdd)]
        found = RigidBodyDynamics.from_urdf(text)(*states).detach().numpy()
        np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-9 * max(1.0, np.abs(wanted).max()))
        # The URDF that is made of it has the same rigid body and damping.
        again = RobotModel.from_urdf(robot.urdf or b"", gravity=robot.gravity)
        torch.testing.assert_close(again.pi, robot.pi, rtol=1e-9, atol=1e-9)
        torch.testing.assert_close(again.damping, robot.damping)
        torch.testing.assert_close(
            again.inverse_dynamics(*states), robot.inverse_dynamics(*states), rtol=1e-9, atol=1e-9
        )


def arm(joint: str = "", inside: str = "", beside: str = "", head: str = "") -> str:
    return (
        f'<mujoco model="arm"><compiler angle="radian"/>{head}<worldbody>'
        '<body name="base"><body name="link" pos="0 0 .5"><joint name="j" '
        f'axis="0 1 0" {joint}/><inertial mass="2" pos=".3 0 0" diaginertia=".01 .02 .03"/>{inside}</body></body>'
        f"</worldbody>{beside}</mujoco>"
    )


def test_each_number_of_a_joint_acts_as_it_should() -> None:
    """By hand, about what the bare arm takes; dry friction in motion."""
    zero = torch.zeros(1, dtype=torch.float64)
    for joint, q, qd, qdd, torque in (
        ('armature="0.7"', 0.0, 0.0, 2.0, 1.4),
        ('damping="0.3"', 0.0, 2.0, 0.0, 0.6),
        ('frictionloss="0.4"', 0.0, -2.0, 0.0, -0.4),
        ('stiffness="5" springref="0.2"', 0.5, 0.0, 0.0, 1.5),
    ):
        with torch.no_grad():
            bare, found = (
                RigidBodyDynamics.from_urdf(arm(words))(zero + q, zero + qd, zero + qdd) for words in ("", joint)
            )
        assert float(found - bare) == pytest.approx(torque, abs=1e-12), joint
    robot = RobotModel.from_urdf(arm('range="-1.5 0.7" actuatorfrcrange="-8 8"'))
    assert float(robot.lower) == pytest.approx(-1.5)
    assert float(robot.upper) == pytest.approx(0.7)
    assert float(robot.effort) == 8.0


def test_a_joint_that_follows_another_mimics_it() -> None:
    second = '<body name="tip"><joint name="k" ref="0.1" axis="0 1 0"/><geom size=".1"/></body>'
    held = '<equality><joint joint1="k" joint2="j" polycoef="0.3 2 0 0 0"/></equality>'
    robot = RobotModel.from_urdf(arm("", second, held))
    assert robot.joint_names == ("j",)
    mimic = next(joint.mimic for joint in robot.description.joints if joint.name == "k")
    assert mimic is not None
    assert (mimic.joint, mimic.multiplier) == ("j", 2.0)
    assert mimic.offset == pytest.approx(0.4)
    with pytest.raises(RobotError, match="equality at joint 'k' is no straight line"):
        RobotModel.from_urdf(arm("", second, held.replace("2 0 0 0", "2 1 0 0")))


@pytest.mark.parametrize("seed", range(4))
def test_what_is_exported_is_read_again(seed: int) -> None:
    """Through ``to_mjcf``: rigid body, friction, rotors and springs."""
    robot = RobotModel.from_urdf(random_mjcf(seed, 5).encode())
    model = RigidBodyDynamics.from_urdf(random_mjcf(seed, 5))
    again = RigidBodyDynamics.from_urdf(torchrbd.to_mjcf(model))
    order = [again.robot.joint_names.index(name) for name in robot.joint_names]
    q, qd, qdd = (torch.from_numpy(x) for x in random_states(seed, 3, robot.n_dof))
    back = np.argsort(order)
    found = again(*(x[:, back] for x in (q, qd, qdd)))[:, order]
    torch.testing.assert_close(found, model(q, qd, qdd), rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (arm('type="ball"'), "joint 'j' of body 'link' is a ball joint; replace it by three hinges"),
        (
            arm().replace("<body name=\"base\">", '<body name="base"><freejoint name="root"/>'),
            "joint 'root' of body 'base' is a free joint; .* on a fixed base",
        ),
        (arm(inside='<body name="x"><joint/><geom size=".1"/></body>'), "joint of body 'x' has no name"),
        (arm(inside='<geom type="cube"/>'), "MuJoCo .* does not take it: .*"),
        (arm(beside='<equality><weld body1="link" body2="base"/></equality>'), "<weld> closes a loop"),
        (arm(head='<include file="other.xml"/>'), "<include> takes another file"),
        (arm(inside='<body name="x"><joint name="k"/><geom type="mesh" mesh="m"/></body>'), "body 'x' would come"),
        (arm(head='<extension><plugin plugin="p"/></extension>'), "<extension> takes another file"),
        (arm(inside='<replicate count="1000000000"><geom size=".1"/></replicate>'), "<replicate> makes many bodies"),
        (arm(inside='<skin file="f.skn"/><light texture="t" file="l.png"/>'), '<light file="l.png">: no other file'),
        ('<!DOCTYPE mujoco [<!ENTITY a "b">]>' + arm(), "declares a document type or entities"),
    ],
)  # fmt: skip
def test_what_cannot_be_read_is_told(text: str, words: str) -> None:
    with pytest.raises(RobotError, match=words):
        RobotModel.from_urdf(text.encode())


def test_meshes_are_left_out_where_a_body_has_its_inertia(tmp_path: Path) -> None:
    """No file is opened beside the robot's own; Python tells of each, and MuJoCo would complain of those missing."""
    shapes = (
        '<asset><mesh name="m" file="/nowhere/m.stl"/><texture name="t" type="2d" file="/nowhere/t.png"/>'
        '<material name="c" texture="t"/></asset><default><geom type="mesh" material="c"/></default>'
    )
    geoms = '<geom type="mesh" mesh="m" material="c"/><geom mesh="m"/><geom type="sphere" size=".1" material="c"/>'
    (tmp_path / "arm.xml").write_text(arm(inside=geoms, head=shapes))
    robot = RobotModel.from_urdf(tmp_path / "arm.xml")
    torch.testing.assert_close(robot.pi, RobotModel.from_urdf(arm()).pi)
    read_alone(tmp_path / "arm.xml", "nowhere", "import mujoco, torchrbd.robot.mjcf")


def test_without_mujoco_the_remedy_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(OptionError, match="MuJoCo is not installed: pip install mujoco"):
        RobotModel.from_urdf(arm())


def test_xacro_is_told_with_the_command(tmp_path: Path) -> None:
    for name, made in (("arm.urdf.xacro", "arm.urdf"), ("arm.xacro", "arm.urdf")):
        with pytest.raises(RobotError, match=f"xacro {tmp_path}/{name} > {made}$"):
            RobotModel.from_urdf(tmp_path / name)
