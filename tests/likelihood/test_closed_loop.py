"""An arm that sticks at reversals and breaks away, driven by a controller that reads encoder steps, is not late."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from likelihood.arms import rows_of, wrong_robot
from likelihood.fits import carried
from simulated import Motion, joint_names
from vision_head.motion import sines

from torchrbd.diagnosis.hypotheses import average_over_shapes
from torchrbd.effects import Site
from torchrbd.effects.registry import effect
from torchrbd.likelihood.learning import learn
from torchrbd.likelihood.likelihood import Likelihood
from torchrbd.likelihood.machine import Machine
from torchrbd.recordings import Recording

LINK = """<link name="{name}"><inertial><origin xyz="0.01 0 {centre}"/><mass value="{mass}"/>
<inertia ixx="{across}" iyy="{across}" izz="0.003" ixy="0" ixz="0" iyz="0"/></inertial></link>"""
JOINT = """<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/>
<origin xyz="0 0 {height}"/><axis xyz="0 1 0"/><limit lower="-2" upper="2" effort="500" velocity="8"/></joint>"""
UPRIGHT = "\n".join(
    (
        '<robot name="upright"><link name="base"/>',
        LINK.format(name="upper", centre=0.19, mass=3.2, across=0.048),
        LINK.format(name="lower", centre=0.14, mass=1.7, across=0.016),
        JOINT.format(name="shoulder", parent="base", child="upper", height=0.5),
        JOINT.format(name="elbow", parent="upper", child="lower", height=0.4),
        "</robot>",
    )
)
REACH, VISCOUS, COULOMB = np.array([1.28, 1.6]), np.array([0.6, 0.25]), np.array([1.1, 0.5])
STEP, BANDWIDTH_HZ, DAMPING, SPEED_HZ = 2 * np.pi / 2**17, 6.0, 0.8, 60.0
CONTROL_HZ, SUBSTEPS, EVERY = 1000.0, 2, 2


def wanted(seed: int, duration_s: float) -> Motion:
    """Sum five slow sines a joint."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, duration_s, 1.0 / CONTROL_HZ)
    hz = rng.uniform(0.06, 0.6, (2, 5))
    size, phase = rng.standard_normal((2, 5)) / np.sqrt(hz), rng.uniform(0, 2 * np.pi, (2, 5))
    size *= (REACH / np.abs(sines(t, size, 2 * np.pi * hz, phase).q).max(0))[:, None]
    return sines(t, size, 2 * np.pi * hz, phase)


def controlled(seed: int, duration_s: float = 30.0) -> Recording:
    """Record an arm that is held to a motion by torques of what its encoders read, and of differences of that."""
    model = pin.buildModelFromXML(UPRIGHT)
    data, moved, dt = model.createData(), wanted(seed, duration_s), 1.0 / CONTROL_HZ / SUBSTEPS
    inertia = np.mean([np.diag(pin.crba(model, data, q)) for q in moved.q[::500]], axis=0)
    omega, keeps = 2 * np.pi * BANDWIDTH_HZ, np.exp(-2 * np.pi * SPEED_HZ / CONTROL_HZ)
    q, qd, speed = moved.q[0].copy(), moved.qd[0].copy(), moved.qd[0].copy()
    before, seen, tau = q, np.empty_like(moved.q), np.empty_like(moved.q)
    for k in range(len(moved.t)):
        seen[k] = np.round(q / STEP) * STEP
        speed = keeps * speed + (1.0 - keeps) * (seen[k] - before) * CONTROL_HZ
        before = seen[k]
        pull = omega**2 * (moved.q[k] - seen[k]) + 2 * DAMPING * omega * (moved.qd[k] - speed)
        tau[k] = pin.nonLinearEffects(model, data, q, qd) + inertia * (moved.qdd[k] + pull)
        for _ in range(SUBSTEPS):
            qd = qd + dt * pin.aba(model, data, q, qd, tau[k] - VISCOUS * qd)
            mobility = pin.computeMinverse(model, data, q)
            for j, most in enumerate(COULOMB * dt):
                # Coulomb friction stops a joint, or takes from its speed what it can.
                qd = qd + mobility[:, j] * np.clip(-qd[j] / mobility[j, j], -most, most)
            q = q + dt * qd
    tau += 0.02 * np.sqrt(np.mean(tau**2, axis=0)) * np.random.default_rng(seed).standard_normal(tau.shape)
    return Recording.from_arrays("loop", joint_names(UPRIGHT), moved.t[::EVERY], seen[::EVERY], tau[::EVERY])


@pytest.fixture(scope="module")
def fit() -> Likelihood:
    return learn(Machine(rows_of(wrong_robot(UPRIGHT, 1), [controlled(5)])))


@pytest.mark.parametrize("name", ["time_delay", "actuator_lag"])
@pytest.mark.parametrize("joint", [0, 1])
def test_no_joint_is_late(fit: Likelihood, name: str, joint: int) -> None:
    rows, e, site = carried(fit), effect(name), Site(joint=joint)
    shapes = e.shapes(rows.columns.scale(site))
    found = average_over_shapes(fit, rows, [rows.columns.candidate(e, site, shape) for shape in shapes])
    assert found is not None
    assert found.log_evidence < 5
