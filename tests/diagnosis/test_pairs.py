"""Pairs of a real and a simulated recording: what differs is found, whatever the simulator has beyond the URDF."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from robot.random_robots import random_urdf
from simulated import Motion, inverse_dynamics, joint_names, multisine

import torchrbd
from torchrbd.dataset.simulated import Simulated
from torchrbd.export import write_diagnosis
from torchrbd.inference.physical.fitting import judge
from torchrbd.inference.preparation import Prepared, prepare
from torchrbd.inference.settings import Settings
from torchrbd.recordings import Recording
from torchrbd.report.page import Page
from torchrbd.report.text.verdict import badge
from torchrbd.robot import RobotModel

EFFECTS = ("viscous_friction", "coulomb_friction", "stribeck_friction", "torque_offset")
NOISE = 0.02


def arm(seed: int, n_joints: int = 2) -> str:
    return random_urdf(seed, n_joints, kinds=("revolute",), branching=0.0, massless=0.0)


def damped(motion: Motion) -> np.ndarray:
    return 0.9 * motion.qd


def stribeck(motion: Motion) -> np.ndarray:
    speed = motion.qd[:, -1]
    tau = damped(motion)
    tau[:, -1] += np.sign(speed) * (0.6 + 1.4 * np.exp(-((speed / 0.2) ** 2)))
    return tau


def recorded(
    urdf: str,
    friction,
    *,
    name: str = "real",
    noise: float = NOISE,
    rate_hz: float = 200.0,
    seconds: float = 15.0,
    begin_s: float = 0.0,
    off: float = 0.0,
) -> Recording:
    """Record the motion of one seed from ``begin_s`` on, ``off`` rad apart; a simulator's has no noise."""
    names = joint_names(urdf)
    motion = multisine(len(names), 3, duration_s=begin_s + seconds, rate_hz=rate_hz)
    other = multisine(len(names), 77, duration_s=begin_s + seconds, rate_hz=rate_hz)
    motion = Motion(motion.t, *(getattr(motion, k) + off * getattr(other, k) for k in ("q", "qd", "qdd")))
    kept = motion.t >= begin_s - 1e-9
    motion = Motion(motion.t[kept] - begin_s, motion.q[kept], motion.qd[kept], motion.qdd[kept])
    tau, rng = inverse_dynamics(urdf, motion) + friction(motion), np.random.default_rng(5)
    tau = tau + noise * np.sqrt(np.mean(tau**2, 0)) * rng.standard_normal(tau.shape)
    q = motion.q + 1e-5 * bool(noise) * rng.standard_normal(tau.shape)
    return Recording.from_arrays(name, names, motion.t, q, tau)


def simulation(urdf: str, friction=damped, **options) -> Recording:
    return recorded(urdf, friction, name="sim", noise=0.0, **options)


def read(urdf: str, real: Recording, simulated: Recording | None) -> Prepared:
    settings = Settings(simulated=() if simulated is None else (simulated,))
    return prepare(RobotModel.from_urdf(urdf), [real], settings, ())


def left(prepared: Prepared) -> float:
    """Return the mean held-out nmse of the model that all is compared with."""
    return judge(prepared.judging, prepared.prior.reference).mean_nmse


def matched(prepared: Prepared) -> Simulated:
    (one,) = prepared.reading.simulated
    return one


@pytest.mark.parametrize(
    ("options", "shift"),
    [
        ({"rate_hz": 500.0}, 0.0),
        ({"rate_hz": 100.0}, 0.0),
        ({"seconds": 13.0}, 0.0),
        ({"begin_s": 0.3}, -0.3),
        ({"off": 0.02}, 0.0),
    ],
    ids=["faster", "slower", "shorter", "begun later", "other motion by 2 %"],
)
def test_what_the_simulator_has_is_no_difference(options: dict[str, float], shift: float) -> None:
    urdf = arm(4)
    real = recorded(urdf, damped)
    prepared = read(urdf, real, simulation(urdf, **options))
    assert left(prepared) < 2e-4
    assert left(read(urdf, real, None)) > 5e-3
    assert matched(prepared).shift_s == pytest.approx(shift, abs=2e-3)


def test_friction_of_the_simulator_is_moved_to_the_recorded_velocity() -> None:
    """A tenth apart in velocity, its damping at its own velocity would leave a hundredth of what damping makes."""
    urdf = arm(4)
    real = recorded(urdf, damped)
    without, apart = left(read(urdf, real, None)), left(read(urdf, real, simulation(urdf, off=0.1)))
    assert apart - left(read(urdf, real, simulation(urdf))) < 2e-4 < 0.02 * without


def test_friction_that_the_urdf_has_counts_once() -> None:
    urdf = arm(4)
    told = re.sub(r'(<joint name="[^"]*" type="revolute">)', r'\1<dynamics damping="0.5" friction="0.2"/>', urdf)
    assert told != urdf
    assert left(read(told, recorded(urdf, damped), simulation(urdf))) < 2e-4


def test_differences_of_inertia_are_those_to_the_simulator() -> None:
    """The simulator is 20 % heavier than the URDF, the robot as heavy: nothing differs."""
    urdf = arm(4)
    heavy = re.sub(r'<mass value="([^"]+)"', lambda m: f'<mass value="{1.2 * float(m[1])!r}"', urdf)
    prepared = read(urdf, recorded(heavy, damped), simulation(heavy))
    assert left(prepared) < 2e-4
    x = prepared.fit().pi
    assert float((x - prepared.robot.pi).abs().max()) < 0.1 * float(prepared.robot.pi.abs().max())


@pytest.fixture(scope="module")
def found() -> torchrbd.Diagnosis:
    urdf = arm(4)
    return torchrbd.diagnose(urdf, recorded(urdf, stribeck), simulated=simulation(urdf, rate_hz=500.0), effects=EFFECTS)


def test_only_what_differs_is_named(found: torchrbd.Diagnosis) -> None:
    assert [(f.effect, f.joints) for f in found.findings] == [("stribeck_friction", ("joint2",))]
    assert found.findings[0].parameters["static"].value == pytest.approx(2.0, rel=0.2)


def test_the_simulation_is_named_as_what_is_compared_with(found: torchrbd.Diagnosis, tmp_path: Path) -> None:
    assert found.simulated == ("sim",)
    assert found.statement.startswith("The simulation lacks Stribeck friction at joint2.")
    assert "URDF" not in found.statement
    assert "compared with the simulation sim (for real)" in found.identification.notes[0]
    write_diagnosis(found, tmp_path / "d.json")
    assert json.loads((tmp_path / "d.json").read_text())["simulated"] == ["sim"]
    assert Page(found).models["urdf"] == "simulation"
    assert badge(replace(found, verdict="consistent")) == "✓ simulation consistent"


def test_a_robot_as_simulated_is_consistent() -> None:
    urdf = arm(4)
    result = torchrbd.diagnose(urdf, recorded(urdf, damped), simulated=[simulation(urdf)], effects=EFFECTS)
    assert (result.verdict, result.findings, result.unexplained) == ("consistent", (), ())
    assert result.statement.startswith("The simulation as given explains the recordings")


def test_another_motion_is_told_and_an_unlike_one_refused() -> None:
    urdf = arm(4)
    real = recorded(urdf, damped)
    result = torchrbd.identify(urdf, real, simulated=simulation(urdf, off=0.2))
    (doubt,) = (d for d in result.doubts if d.startswith("sim moves otherwise than real"))
    motion, other = (multisine(2, seed, duration_s=15.0, rate_hz=200.0).qd for seed in (3, 77))
    parts = 20.0 * np.sqrt(np.mean(other**2, 0) / np.mean(motion**2, 0))
    assert [int(part) for part in re.findall(r"(\d+) %", doubt)] == pytest.approx(parts.tolist(), rel=0.15)
    with pytest.raises(torchrbd.RecordingError, match=r"sim: moves otherwise than real.*same commands"):
        torchrbd.identify(urdf, real, simulated=simulation(urdf, off=1.0))


def test_unusable_simulations_are_refused() -> None:
    urdf = arm(4)
    real, sim = recorded(urdf, damped), simulation(urdf)
    chunk = next(iter(sim.chunks(10**6)))

    def changed(keep: slice | np.ndarray = slice(None), tau: np.ndarray | None = None) -> Recording:
        tau = chunk.tau if tau is None else tau
        return Recording.from_arrays("sim", sim.joints, chunk.t[keep], chunk.q[keep], tau[keep])

    silent = np.where(np.arange(2) == 1, np.nan, chunk.tau)
    gap = np.abs(chunk.t - 7.0) > 0.5
    for simulated, words in (
        ([sim, sim], "2 simulated recordings for 1 real ones"),
        (changed(tau=silent), "no torque for joint2"),
        (changed(keep=gap), "2 pieces with gaps"),
        (changed(keep=slice(None, None, 40)), "at 5 Hz; the cut-off .* Hz needs"),
        (simulation(arm(4, 3)), "is of joints"),
        ("nowhere.csv", "nowhere.csv"),
    ):
        with pytest.raises(torchrbd.InputError, match=words):
            torchrbd.identify(urdf, real, simulated=simulated)


def controlled(urdf: str, friction, *, seconds: float, every: int, noise: float, name: str) -> Recording:
    """Let MuJoCo follow a motion by computed torque with soft feedback, and record it at every ``every``-th ms."""
    model = mujoco.MjModel.from_xml_string(urdf)
    model.opt.timestep, model.opt.integrator = 1e-3, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_LIMIT | mujoco.mjtDisableBit.mjDSBL_CONTACT
    data, control = mujoco.MjData(model), mujoco.MjData(model)
    names = [model.joint(k).name for k in range(model.njnt)]
    move = multisine(model.nv, 8, duration_s=seconds, rate_hz=1000.0)
    data.qpos[:], data.qvel[:] = move.q[0], move.qd[0]
    q, tau = np.empty((2, len(move.t), model.nv))
    for k in range(len(move.t)):
        control.qpos[:], control.qvel[:] = data.qpos, data.qvel
        control.qacc[:] = move.qdd[k] + 100.0 * (move.q[k] - data.qpos) + 20.0 * (move.qd[k] - data.qvel)
        mujoco.mj_inverse(model, control)
        q[k], tau[k] = data.qpos, control.qfrc_inverse
        data.qfrc_applied[:] = tau[k] - friction(data.qvel)
        mujoco.mj_step(model, data)
    t, q, tau = move.t[::every], q[::every], tau[::every]
    rng = np.random.default_rng(6)
    tau = tau + noise * np.sqrt(np.mean(tau**2, 0)) * rng.standard_normal(tau.shape)
    return Recording.from_arrays(name, names, t, q + 1e-5 * bool(noise) * rng.standard_normal(q.shape), tau)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [41, 42])
def test_pairs_from_mujoco(seed: int) -> None:
    """All effects are searched for; simulator and robot are moved by feedback, so that their motions differ."""
    urdf = arm(seed, 3)

    def simple(qd: np.ndarray) -> np.ndarray:
        return 0.8 * qd + 0.3 * np.tanh(qd / 0.003)

    def rough(qd: np.ndarray) -> np.ndarray:
        tau = simple(qd)
        tau[1] += 1.2 * np.tanh(qd[1] / 0.003) * np.exp(-((qd[1] / 0.2) ** 2))
        return tau

    sim = controlled(urdf, simple, seconds=28.0, every=2, noise=0.0, name="sim")
    real = controlled(urdf, rough, seconds=30.0, every=4, noise=NOISE, name="real")
    result = torchrbd.diagnose(urdf, real, simulated=sim)
    assert [(f.effect, f.joints) for f in result.findings] == [("stribeck_friction", ("joint2",))]
    same = controlled(urdf, simple, seconds=30.0, every=4, noise=NOISE, name="real")
    assert torchrbd.diagnose(urdf, same, simulated=sim).verdict == "consistent"
