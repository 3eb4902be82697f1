"""What effects are in MJCF, against MuJoCo: the same torques."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from effects.sites import ROBOT, signals, states
from lxml import etree

from torchrbd.effects import Effect, Site, Term, effect
from torchrbd.robot import PARAMETERS

mujoco = pytest.importorskip("mujoco")
STATES = states(40, seed=7)
"""q, qd, qdd (n, N)."""


def term(name: str, site: Site, given: dict[str, float]) -> Term:
    w, shape = effect(name).coefficients(given)
    return Term(effect(name), site, torch.tensor(w, dtype=torch.float64), shape)


def text(value: object) -> str:
    return value if isinstance(value, str) else " ".join(map(repr, map(float, np.atleast_1d(value))))  # type: ignore[arg-type]


def mjcf(*terms: Term) -> mujoco.MjModel:
    """Return the robot with what the terms say, each alone on its element; bodies and tendons where they belong."""
    root = etree.fromstring(mujoco.MjSpec.from_string(ROBOT.urdf).to_xml())
    world = root.find("worldbody")
    base = etree.Element("body", name="base")
    base.extend(list(world))
    world.append(base)
    for joint in root.iter("joint"):
        del joint.attrib["actuatorfrcrange"]
    for one in terms:
        site = one.site
        name = "" if site.joint is None else ROBOT.joint_names[site.joint]
        joint = root.find(f".//joint[@name='{name}']")
        for element, attributes in one.effect.mjcf(one.parameters_by_name()).items():
            values = {key: text(value) for key, value in attributes.items()}
            match element:
                case "joint":
                    joint.attrib.update(values)
                case "general":
                    actuators = root.find("actuator")
                    actuators = etree.SubElement(root, "actuator") if actuators is None else actuators
                    if "delay" in values:
                        values["nsample"] = "50"
                    etree.SubElement(actuators, "general", joint=name, **values)
                case "dcmotor":
                    motor = {"motorconst": "1", "resistance": "1e6"}
                    etree.SubElement(etree.SubElement(root, "actuator"), "dcmotor", joint=name, **motor, **values)
                case "fixed":
                    coefficients = values.pop("coef", "1").split()
                    tendon = etree.SubElement(etree.SubElement(root, "tendon"), "fixed", **values)
                    for j, coefficient in zip((site.joint, site.other), coefficients, strict=False):
                        etree.SubElement(tendon, "joint", joint=ROBOT.joint_names[j], coef=coefficient)
                case "inertial":
                    body = root.find(f".//body[@name='{ROBOT.body_names[site.body]}']")
                    etree.SubElement(etree.SubElement(body, "body"), "inertial", **values)
                case "body":
                    move(base if joint is None else joint.getparent(), attributes)
                case _:
                    raise AssertionError(element)
    return mujoco.MjModel.from_xml_string(etree.tostring(root, encoding="unicode"))


def move(body: etree._Element, change: dict) -> None:
    pos = np.array(body.get("pos", "0 0 0").split(), dtype=float) + np.array(change.get("pos", (0, 0, 0)))
    turned = np.zeros(4)
    mujoco.mju_mulQuat(turned, np.array(change["quat"]), np.array(body.get("quat", "1 0 0 0").split(), dtype=float))
    body.set("pos", text(pos))
    body.set("quat", text(turned))


def inverse(model: mujoco.MjModel) -> np.ndarray:
    """Return the torques of the states (n, N)."""
    data, found = mujoco.MjData(model), []
    order = [model.jnt_dofadr[model.joint(name).id] for name in ROBOT.joint_names]
    for q, qd, qdd in zip(*(x.T.numpy() for x in STATES), strict=True):
        for whole, own in ((data.qpos, q), (data.qvel, qd), (data.qacc, qdd)):
            whole[order] = own
        mujoco.mj_inverse(model, data)
        found.append(data.qfrc_inverse[order].copy())
    return np.stack(found, -1)


def added(one: Term) -> np.ndarray:
    """Return the torque of a term at all joints, (n, N)."""
    with torch.no_grad():
        tau = one(signals(*STATES))
    if one.effect.whole_robot:
        return tau.numpy()
    whole = np.zeros(STATES[0].shape)
    whole[one.site.joint] = tau.numpy()
    return whole


ONE_JOINT = {
    "viscous_friction": {"viscous": 0.7},
    "quadratic_drag": {"drag": 0.4},
    "rotor_inertia": {"rotor_inertia": 0.3},
    "joint_spring": {"stiffness": 5.0, "rest_position": 0.3},
    "coulomb_friction": {"coulomb": 0.8},
    "encoder_offset": {"offset": 1e-4},
    "geometry_error": {"x": 1e-4, "y": -2e-4, "z": 3e-4, "rx": 1e-4, "ry": 2e-4, "rz": -1e-4},
}


@pytest.mark.parametrize("name", ONE_JOINT)
def test_one_joint(name: str) -> None:
    one = term(name, Site(1), ONE_JOINT[name])
    found, expected = inverse(mjcf(one)) - inverse(mjcf()), added(one)
    moving = np.abs(STATES[1][1].numpy()) > 0.5  # MuJoCo's dry friction yields around rest
    first_order = 2e-3 if one.effect.uses_load else 1e-6
    np.testing.assert_allclose(found[:, moving], expected[:, moving], atol=first_order * np.abs(expected).max())


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_one_sided_spring_is_a_slack_tendon(side: float) -> None:
    one = term("one_sided_spring", Site(1), {"contact_position": 0.1, "side": side, "stiffness": 5.0})
    np.testing.assert_allclose(inverse(mjcf(one)) - inverse(mjcf()), added(one), atol=1e-9)


@pytest.mark.parametrize("k", [3.0, -3.0])
def test_couplings_are_tendons_with_a_term_at_each_joint(k: float) -> None:
    s = np.sign(k)
    position = term("joint_coupling", Site(0, other=2), {"stiffness": k, "offset": 0.6})
    mirrored = term("joint_coupling", Site(2, other=0), {"stiffness": k, "offset": s * 0.6})
    own = [term("joint_spring", Site(j), {"stiffness": abs(k), "rest_position": 0.0}) for j in (0, 2)]
    expected = sum(added(one) for one in (position, mirrored, *own))
    np.testing.assert_allclose(inverse(mjcf(position)) - inverse(mjcf()), expected, atol=1e-9)
    speed, back = (term("velocity_coupling", Site(*pair), {"viscous": k}) for pair in ((0, 2), (2, 0)))
    own = [term("viscous_friction", Site(j), {"viscous": abs(k)}) for j in (0, 2)]
    expected = sum(added(one) for one in (speed, back, *own))
    np.testing.assert_allclose(inverse(mjcf(speed)) - inverse(mjcf()), expected, atol=1e-9)


@pytest.mark.parametrize("ratio", [1.0, -0.5])
def test_coupled_motor_is_a_tendon(ratio: float) -> None:
    numbers = {"viscous": 0.7, "coulomb": 0.8, "rotor_inertia": 0.3, "ratio": ratio}
    one = term("coupled_motor", Site(1, other=0), numbers)
    found, expected = inverse(mjcf(one)) - inverse(mjcf()), added(one)
    moving = (STATES[1][1] + ratio * STATES[1][0]).abs().numpy() > 0.5  # MuJoCo's dry friction yields around rest
    np.testing.assert_allclose(found[:, moving], expected[:, moving], atol=1e-5 * np.abs(expected).max())


def test_payload_is_a_body() -> None:
    inertia = dict(zip(PARAMETERS[4:], (0.22, 0.03, 0.18, -0.04, 0.09, 0.1), strict=True))
    one = term("payload", Site(body=2), {"mass": 1.5, "x": 0.1, "y": -0.2, "z": 0.3, **inertia})
    expected = added(one)
    np.testing.assert_allclose(inverse(mjcf(one)) - inverse(mjcf()), expected, atol=1e-5 * np.abs(expected).max())


def test_base_tilt_turns_the_base() -> None:
    one = term("base_tilt", Site(), {"tilt_x": 2e-4, "tilt_y": -1e-4})
    expected = added(one)
    np.testing.assert_allclose(inverse(mjcf(one)) - inverse(mjcf()), expected, atol=1e-3 * np.abs(expected).max())


def actuated(one: Term, control: float, q: float = 0.0) -> float:
    model = mjcf(one)
    data = mujoco.MjData(model)
    data.qpos[:], data.ctrl[:] = q, control
    mujoco.mj_forward(model, data)
    return float(data.qfrc_actuator[one.site.joint])


def test_actuators_turn_the_recorded_torque_into_the_one_that_acts() -> None:
    assert actuated(term("torque_offset", Site(1), {"offset": 0.7}), 3.0) == pytest.approx(2.3)
    assert actuated(term("torque_scale", Site(1), {"gain": 1.25}), 3.0) == pytest.approx(2.4)
    saturated = term("torque_saturation", Site(1), {"limit": 2.0, "slope": 3.0})
    assert actuated(saturated, 1.9) == pytest.approx(1.9)
    assert actuated(saturated, -9.0) == pytest.approx(-2.0)
    uneven = term("asymmetric_coulomb_friction", Site(1), {"coulomb_plus": 1.0, "coulomb_minus": 0.4})
    loss = mjcf(uneven).dof_frictionloss[1]
    for direction, expected in ((1.0, 1.0), (-1.0, -0.4)):
        assert 5.0 - actuated(uneven, 5.0) + direction * loss == pytest.approx(expected)


def test_cogging_takes_the_torque_of_the_ripple() -> None:
    one = term("torque_ripple", Site(1), {"amplitude": 0.4, "order": 11.0, "phase": 0.7})
    for q in (-0.3, 0.1, 0.5):
        assert actuated(one, 0.0, q) == pytest.approx(-0.4 * np.sin(11 * q + 0.7), abs=1e-6)


def responses(one: Term, steps: int = 200) -> np.ndarray:
    """Return the actuator's torque (steps,) after its control has stepped to one."""
    model = mjcf(one)
    model.opt.timestep, model.opt.integrator = 1e-3, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    data, found = mujoco.MjData(model), []
    for _ in range(steps):
        data.ctrl[:] = 1.0
        mujoco.mj_step(model, data)
        found.append(float(data.qfrc_actuator[one.site.joint]))
    return np.array(found)


def test_lag_and_delay_of_a_command() -> None:
    t = 1e-3 * np.arange(200)
    lag = responses(term("actuator_lag", Site(1), {"time_constant": 0.03}))
    np.testing.assert_allclose(lag, 1 - np.exp(-t / 0.03), atol=2e-3 + 1e-3 / 0.03)
    late = responses(term("time_delay", Site(1), {"delay": -0.02, "step": -0.02}))
    assert abs(int(np.argmax(late > 0.5)) - 20) <= 1


def test_dahl_is_the_bristle_of_a_motor() -> None:
    """A joint that is turned slowly meets the same friction, presliding and all."""
    one = term("presliding_hysteresis", Site(1), {"coulomb": 0.5, "distance": 0.006})
    model = mjcf(one)
    model.opt.timestep, model.opt.gravity[:] = 1e-4, 0.0
    data, q, friction = mujoco.MjData(model), [], []
    for k in range(4000):
        speed = 0.5 * np.cos(2 * np.pi * k / 2000)
        data.qvel[:] = [0.0, speed, 0.0]
        mujoco.mj_forward(model, data)
        friction.append(-float(data.qfrc_actuator[1]))
        q.append(float(data.qpos[1]))
        mujoco.mj_step(model, data)
    x = torch.zeros(3, ROBOT.n_dof, len(q), dtype=torch.float64)
    x[0, 1], x[1, 1] = torch.tensor(q), 0.5
    own = one(signals(*x)).detach().numpy()
    settled = slice(1500, None)
    np.testing.assert_allclose(np.array(friction)[settled], own[settled], atol=0.02)


def test_effects_without_a_word_say_so() -> None:
    silent: list[Effect] = [
        effect(name) for name in ("load_dependent_friction", "backlash", "external_wrench", "counterbalance")
    ]
    assert all(one.mjcf({}) == {} and one.export_note for one in silent)
