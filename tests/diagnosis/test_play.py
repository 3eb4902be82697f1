"""Play in a gear as MuJoCo simulates it: named where it may be, and where it may not nothing else is in its place."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from diagnosis.hanging_arm import URDF, multisine
from shortened import slow_but

import torchrbd
from torchrbd.recordings import Recording

pytestmark = pytest.mark.usefixtures("fit_alone")

# The elbow's motor turns by itself; a tendon of limited length holds the link to it.
MJCF = """<mujoco>
  <option timestep=".0002" integrator="implicitfast"/><compiler angle="radian"/>
  <worldbody>
    <body name="upper">
      <inertial pos=".02 0 -.15" mass="2" diaginertia=".02 .02 .004"/><joint name="shoulder" axis="0 1 0"/>
      <body name="motor" pos="0 0 -.3">
        <inertial pos="0 0 0" mass="1e-4" diaginertia="1e-7 1e-7 1e-7"/>
        <joint name="elbow" axis="0 1 0" armature="{inertia}" frictionloss="{motor_friction}"/>
      </body>
      <body name="lower" pos="0 0 -.3">
        <inertial pos="0 0 -.2" mass="1.2" diaginertia=".012 .012 .002"/>
        <joint name="link" axis="0 1 0" frictionloss="{link_friction}"/>
      </body>
    </body>
  </worldbody>
  <tendon>
    <fixed name="play" limited="true" range="-{half} {half}" solreflimit=".002 1" solimplimit=".9 .999 .0005">
      <joint joint="link" coef="1"/><joint joint="elbow" coef="-1"/>
    </fixed>
  </tendon>
  <actuator><motor joint="shoulder"/><motor joint="elbow"/></actuator>
</mujoco>"""
INERTIA, SECONDS, RATE_HZ = 0.003, 30.0, 500.0
# What play may be taken for.
RIVALS = [
    "backlash", "joint_elasticity", "rotor_inertia", "viscous_friction", "coulomb_friction", "stribeck_friction",
    "presliding_hysteresis", "time_delay", "actuator_lag", "joint_spring", "torque_offset",
]  # fmt: skip
GAINS, DAMPING = np.array([400.0, 250.0]), np.array([20.0, 8.0])


def recorded(play: float, motor_friction: float = 0.0, link_friction: float = 0.0, seed: int = 0) -> Recording:
    """Record the motors of an arm that follows a multisine: means over samples, noise of a hundredth of the torque."""
    friction = {"motor_friction": motor_friction, "link_friction": link_friction}
    model = mujoco.MjModel.from_xml_string(MJCF.format(half=play / 2, inertia=INERTIA, **friction))
    data, rng, dt = mujoco.MjData(model), np.random.default_rng(seed), model.opt.timestep
    hz, size, phase = rng.uniform(0.1, 0.8, (2, 5)), rng.uniform(0.2, 0.5, (2, 5)), rng.uniform(0.0, 2 * np.pi, (2, 5))
    t = dt * np.arange(round(SECONDS / dt))
    wanted, wanted_speed = multisine(t, hz, size / (1.0 + hz), phase)
    data.qpos[:], data.qvel[:] = wanted[[0, 1, 1], 0], wanted_speed[[0, 1, 1], 0]
    q, tau = np.empty((2, len(t))), np.empty((2, len(t)))
    for k in range(len(t)):
        q[:, k] = data.qpos[:2]
        tau[:, k] = GAINS * (wanted[:, k] - q[:, k]) + DAMPING * (wanted_speed[:, k] - data.qvel[:2])
        data.ctrl[:] = tau[:, k]
        mujoco.mj_step(model, data)
    every = round(1.0 / (RATE_HZ * dt))
    t, q, tau = (x.reshape(*x.shape[:-1], -1, every).mean(-1) for x in (t, q, tau))
    q += 2e-5 * rng.standard_normal(q.shape)
    tau += 0.01 * tau.std(1, keepdims=True) * rng.standard_normal(tau.shape)
    return Recording.from_arrays("play", ["shoulder", "elbow"], t, q.T, tau.T)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("play", "friction"),
    [
        (0.002, {}),
        (0.01, {"motor_friction": 0.1}),
        (0.01, {"link_friction": 0.1}),
        (0.015, {}),
        (0.02, {}),
        (0.05, {}),
    ],
)
def test_play_is_named(play: float, friction: dict[str, float]) -> None:
    result = torchrbd.diagnose(URDF, recorded(play, **friction))
    found = {f.effect: f for f in result.findings}
    assert set(found) - {"coulomb_friction"} == {"backlash", "rotor_inertia"}
    assert ("coulomb_friction" in found) == bool(friction)
    assert {f.joints for f in result.findings} == {("elbow",)}
    assert found["backlash"].parameters["backlash"].value == pytest.approx(play, rel=0.05)
    assert result.unexplained == ()


@pytest.mark.slow
@pytest.mark.parametrize("play", [0.003, 0.01])
def test_nothing_is_named_in_its_place(play: float) -> None:
    result = torchrbd.diagnose(URDF, recorded(play, motor_friction=0.05), exclude=["backlash"])
    assert {(f.effect, f.joints) for f in result.findings} == {
        (e, ("elbow",)) for e in ("coulomb_friction", "rotor_inertia")
    }


@pytest.mark.parametrize("effects", slow_but((RIVALS,), (RIVALS, None)), ids=["rivals", "all"])
def test_no_play_is_none(effects: list[str] | None) -> None:
    result = torchrbd.diagnose(URDF, recorded(1e-9), effects=effects)
    assert {f.effect for f in result.findings} == {"rotor_inertia"}
