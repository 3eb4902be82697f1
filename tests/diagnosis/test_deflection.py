"""Encoders behind the gear: springs between motor and link in MuJoCo, and stiff gears that coarse encoders look at."""

from dataclasses import replace

import numpy as np
import pytest
from robot.random_robots import random_urdf
from simulated import inverse_dynamics, joint_names, multisine

import torchrbd
from torchrbd.diagnosis.deflection import joint_deflections
from torchrbd.diagnosis.springs import with_springs
from torchrbd.effects import effect
from torchrbd.inference.identify import read_arguments
from torchrbd.inference.preparation import prepare
from torchrbd.recordings import Recording

mujoco = pytest.importorskip("mujoco")

JOINTS = ("shoulder", "elbow")
STIFFNESS = {"shoulder": 5000.0, "elbow": 1200.0}
URDF = """<robot name="elastic"><link name="base"/>
<link name="upper"><inertial><origin xyz="0 0 -0.2"/><mass value="4"/>
 <inertia ixx="0.06" iyy="0.06" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>
 <limit lower="-3" upper="3" effort="99" velocity="9"/></joint>
<link name="lower"><inertial><origin xyz="0 0 -0.15"/><mass value="2"/>
 <inertia ixx="0.02" iyy="0.02" izz="0.004" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="elbow" type="revolute"><parent link="upper"/><child link="lower"/><origin xyz="0 0 -0.4"/>
 <axis xyz="0 1 0"/><limit lower="-3" upper="3" effort="99" velocity="9"/></joint></robot>"""
# A motor with its rotor and friction turns a link by a spring, at both joints.
MJCF = """<mujoco><option timestep="0.0005" integrator="implicitfast" gravity="0 0 -9.81"/><worldbody>
<body><inertial pos="0 0 0" mass="1e-6" diaginertia="1e-7 1e-7 1e-7"/>
 <joint name="motor1" axis="0 1 0" armature="0.05" damping="1.5" frictionloss="1"/>
<body><inertial pos="0 0 -0.2" mass="4" diaginertia="0.06 0.06 0.01"/>
 <joint axis="0 1 0" stiffness="5000" damping="1.5"/>
<body pos="0 0 -0.4"><inertial pos="0 0 0" mass="1e-6" diaginertia="1e-7 1e-7 1e-7"/>
 <joint name="motor2" axis="0 1 0" armature="0.05" damping="0.5" frictionloss="0.4"/>
<body><inertial pos="0 0 -0.15" mass="2" diaginertia="0.02 0.02 0.004"/>
 <joint axis="0 1 0" stiffness="1200" damping="0.3"/></body></body></body></body></worldbody>
<actuator><motor joint="motor1"/><motor joint="motor2"/></actuator></mujoco>"""
FRICTION = ("viscous_friction", "coulomb_friction")


def simulated(seed, seconds=16.0, every=8):
    """Return t (N,), the motors' q, the links' q and the motors' torque (N, 2) of a controlled motion."""
    model = mujoco.MjModel.from_xml_string(MJCF)
    data, rng = mujoco.MjData(model), np.random.default_rng(seed)
    omega, phase = 2 * np.pi * rng.uniform(0.1, 1.0, (2, 5)), rng.uniform(0, 2 * np.pi, (2, 5))
    size = 0.5 * rng.uniform(0.3, 0.8, (2, 5)) / omega
    kp, kd, motors = np.array([400.0, 100.0]), np.array([30.0, 6.0]), [0, 2]
    data.qpos[motors] = (size * np.sin(phase)).sum(1)
    rows = []
    for step in range(int(seconds / model.opt.timestep)):
        angle = omega * data.time + phase
        data.ctrl[:] = kp * ((size * np.sin(angle)).sum(1) - data.qpos[motors])
        data.ctrl[:] += kd * ((size * omega * np.cos(angle)).sum(1) - data.qvel[motors])
        if step % every == 0:
            rows.append(np.concatenate(([data.time], data.qpos[motors], data.qpos[[1, 3]], data.ctrl)))
        mujoco.mj_step(model, data)
    t, q, yielding, tau = np.split(np.array(rows), [1, 3, 5], axis=1)
    return t[:, 0], q, q + yielding, tau


def found(urdf, recordings, effects=FRICTION, **options):
    """Return the deflections by joint, of a model with these effects at all joints."""
    robot, sources, settings = read_arguments(urdf.encode(), recordings, options, "diagnose")
    prepared = prepare(robot, sources, settings, [effect(name) for name in effects])
    return {d.joint: d for d in joint_deflections(prepared, prepared.fit(prepared.columns.candidates))}


@pytest.fixture(scope="module")
def elastic():
    return simulated(seed=2)


def recorded(simulation, q_link, name="elastic"):
    t, q, _, tau = simulation
    noise = np.random.default_rng(5).standard_normal(tau.shape)
    return Recording.from_arrays(name, JOINTS, t, q, tau + 0.02 * tau.std(0) * noise, q_link=q_link)


def coarse(q, bits=17):
    step = 2 * np.pi / 2**bits
    return step * np.round(q / step)


@pytest.mark.parametrize("delay_ms", [0, 4, -4])
def test_stiffness_of_two_masses(elastic, delay_ms):
    """Whatever the encoders' zeros, resolution, eccentricity, and the time between the two."""
    link = elastic[2]
    seen = link + 1e-4 * np.sin(link) - 2e-4 * np.cos(link) + [0.3, -0.2]
    late = np.roll(seen, delay_ms // 4, axis=0)  # the rows at the ends are cut off below
    rows = slice(2, -2)
    for joint, d in found(
        URDF, [recorded(tuple(x[rows] for x in elastic), coarse(late[rows]))], (*FRICTION, "rotor_inertia")
    ).items():
        assert d.stiffness is not None
        assert d.stiffness.value == pytest.approx(STIFFNESS[joint], rel=0.05)
        assert d.delay.value == pytest.approx(1e-3 * delay_ms, abs=1e-4)
        assert d.nmse_after < 0.05 * d.nmse_before
        assert d.stiffness_at_least < STIFFNESS[joint]
        slope = np.polyfit(d.load, d.deflection, 1)[0]
        assert slope == pytest.approx(1 / STIFFNESS[joint], rel=0.1)


def test_none_on_stiff_gears():
    """Coarse, eccentric encoders that are read one after the other, and friction that makes the torque follow qd."""
    for seed in (31, 32):
        rng, urdf = np.random.default_rng(seed), random_urdf(seed, 5, kinds=("revolute", "prismatic"))
        names, motion = joint_names(urdf), multisine(5, seed, duration_s=20.0, rate_hz=125.0)
        tau = inverse_dynamics(urdf, motion)
        tau += tau.std(0) * (0.2 * np.tanh(motion.qd / 0.01) + 0.2 * motion.qd + 0.03 * rng.standard_normal(tau.shape))
        delay = rng.uniform(-4e-3, 4e-3)
        eccentric = 2e-4 * rng.standard_normal(5) * np.sin(motion.q + rng.uniform(0, 6, 5))
        link = motion.q - delay * motion.qd + 0.5 * delay**2 * motion.qdd + eccentric + rng.standard_normal(5)
        recording = Recording.from_arrays("stiff", names, motion.t, coarse(motion.q, 15), tau, q_link=coarse(link, 15))
        seen = found(urdf, [recording])
        assert set(seen) == set(names)
        for d in seen.values():
            assert d.stiffness is None
            assert d.nmse_after == d.nmse_before
            assert abs(d.delay.value - delay) < 5 * d.delay.std
            assert "No elasticity at" in d.statement


def test_only_where_there_are_encoders(elastic):
    one = elastic[2].copy()
    one[:, 0] = np.nan
    assert list(found(URDF, [recorded(elastic, one)])) == ["elbow"]
    assert found(URDF, [recorded(elastic, None)]) == {}


def test_a_copy_of_the_position_tells_nothing(elastic):
    copy = np.stack((elastic[1][:, 0], elastic[2][:, 1]), 1)
    assert list(found(URDF, [recorded(elastic, copy)])) == ["elbow"]
    real = recorded(elastic, elastic[2])
    beside = (found(URDF, [recorded(elastic, other, "beside"), real]) for other in (copy, None))
    with_copy, without = (each["shoulder"].stiffness for each in beside)
    assert with_copy == without is not None


def test_a_wrong_unit_is_not_used(elastic):
    degrees = recorded(elastic, np.rad2deg(elastic[2]), "degrees")
    assert found(URDF, [degrees]) == {}
    both = found(URDF, [degrees, recorded(elastic, elastic[2])])
    assert both["elbow"].stiffness is not None
    assert both["elbow"].stiffness.value == pytest.approx(STIFFNESS["elbow"], rel=0.05)


@pytest.mark.slow
def test_told_once(elastic, tmp_path):
    """The diagnosis names the spring once at each joint, with the deflection's stiffness.

    The shoulder's rotor, whose inertia the torque cannot tell from the arm's, is taken for load: .05 of .6 kg m^2.
    """
    effects = ["joint_elasticity", "rotor_inertia", *FRICTION]
    result = torchrbd.diagnose(URDF.encode(), recorded(elastic, elastic[2]), effects=effects)
    springs = [f for f in result.findings if f.effect == "joint_elasticity"]
    assert sorted(f.joints for f in springs) == [("elbow",), ("shoulder",)]
    for finding in springs:
        (joint,) = finding.joints
        off = 0.1 if joint == "shoulder" else 0.05
        assert finding.parameters["stiffness"].value == pytest.approx(STIFFNESS[joint], rel=off)
        assert finding.curve is not None
        assert finding.curve.signal == f"deflection_{joint}"
    torchrbd.write_report(result, tmp_path / "report.html")
    assert "Encoders behind the gears" in (tmp_path / "report.html").read_text()


def test_a_spring_that_the_torque_shows_too_keeps_its_place(elastic):
    measured = tuple(found(URDF, [recorded(elastic, elastic[2])]).values())
    alone = with_springs((), measured)
    assert len(alone) == 2
    assert all("The torque does not show it." in f.statement for f in alone)
    torque = replace(alone[0], nmse_before={alone[0].joints[0]: 0.2}, nmse_after={alone[0].joints[0]: 0.1})
    other = replace(torque, effect="backlash")
    both = with_springs((torque, other), measured)
    assert sorted(f.effect for f in both) == ["backlash", "joint_elasticity", "joint_elasticity"]
    kept = next(f for f in both if f.effect == "joint_elasticity" and f.joints == torque.joints)
    assert kept.nmse_before == torque.nmse_before
    assert "The torque shows it too." in kept.statement
