"""A drive's dead zone in a loop as MuJoCo simulates it: while its command passes through the zone, no torque acts."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from diagnosis.hanging_arm import URDF, multisine

import torchrbd
from torchrbd.recordings import Recording

pytestmark = pytest.mark.usefixtures("fit_alone")

HALF_WIDTH, SECONDS, RATE_HZ, STEP_S = 0.4, 20.0, 250.0, 0.001
ELBOW = 1


def recorded(half_width: float, gain: float, seed: int = 0) -> Recording:
    """Record the commands of an arm that follows a multisine; the lower the gain, the longer in the zone."""
    model = mujoco.MjModel.from_xml_string(URDF.decode())
    model.opt.timestep = STEP_S
    data, rng = mujoco.MjData(model), np.random.default_rng(seed)
    hz, phase = rng.uniform(0.1, 0.8, (2, 5)), rng.uniform(0.0, 2 * np.pi, (2, 5))
    t = STEP_S * np.arange(round(SECONDS / STEP_S))
    wanted, speed = multisine(t, hz, 0.3 / (1.0 + hz), phase)
    data.qpos[:], data.qvel[:] = wanted[:, 0], speed[:, 0]
    q, tau = np.empty((2, len(t))), np.empty((2, len(t)))
    for k in range(len(t)):
        q[:, k] = data.qpos
        tau[:, k] = gain * (wanted[:, k] - q[:, k]) + 0.05 * gain * (speed[:, k] - data.qvel)
        data.qfrc_applied[:] = tau[:, k]
        data.qfrc_applied[ELBOW] -= np.clip(tau[ELBOW, k], -half_width, half_width)
        mujoco.mj_step(model, data)
    every = round(1.0 / (RATE_HZ * STEP_S))
    t, q, tau = t[::every], q[:, ::every], tau[:, ::every]
    q += 2e-5 * rng.standard_normal(q.shape)
    tau += 0.01 * tau.std(1, keepdims=True) * rng.standard_normal(tau.shape)
    return Recording.from_arrays("zone", ["shoulder", "elbow"], t, q.T, tau.T)


@pytest.mark.slow
@pytest.mark.parametrize("gain", [60.0, 200.0])
def test_it_is_named(gain: float) -> None:
    result = torchrbd.diagnose(URDF, recorded(HALF_WIDTH, gain))
    (found,) = result.findings
    assert (found.effect, found.joints) == ("torque_dead_zone", ("elbow",))
    assert found.parameters["half_width"].value == pytest.approx(HALF_WIDTH, rel=0.05)
    assert result.unexplained == ()
