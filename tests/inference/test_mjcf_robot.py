"""Identification with MJCF in place of URDF: what the file tells of joints is known, what it lacks is found."""

from __future__ import annotations

import json
from pathlib import Path

import mujoco
import numpy as np
import pytest
import torch
from simulated import multisine

import torchrbd
from torchrbd.cli import main

FRICTION = ("viscous_friction", "coulomb_friction")
JOINTS = 'axis="0 1 0" armature="{armature}" damping="0.5" stiffness="{stiffness}" springref="0.3"'


def arm(armature: float, stiffness: float, mass: float) -> str:
    joint = JOINTS.format(armature=armature, stiffness=stiffness)
    return f"""
        <mujoco model="arm"><compiler angle="radian"/><worldbody><body name="upper" pos="0 0 1">
        <joint name="j1" {joint}/><inertial mass="{mass}" pos=".2 0 .05" diaginertia=".05 .06 .07"/>
        <body name="lower" pos=".4 0 0"><joint name="j2" {joint}/>
        <inertial mass="1.5" pos=".15 .02 0" diaginertia=".02 .03 .03"/></body></body></worldbody></mujoco>"""


@pytest.fixture(scope="module")
def recording() -> torchrbd.Recording:
    """Of an arm whose upper link is heavier than its file says, with dry friction that the file lacks."""
    motion = multisine(2, 4, duration_s=30.0)
    truth = torchrbd.RigidBodyDynamics.from_urdf(arm(0.4, 20.0, 5.0).encode())
    with torch.no_grad():
        tau = truth(*(torch.from_numpy(x) for x in (motion.q, motion.qd, motion.qdd))).numpy()
    tau = tau + 1.2 * np.tanh(motion.qd / 1e-3)
    rng = np.random.default_rng(5)
    noise = rng.standard_normal((2, *tau.shape))
    return torchrbd.Recording.from_arrays(
        "day", ("j1", "j2"), motion.t, motion.q + 1e-5 * noise[0], tau + 0.05 * noise[1]
    )


@pytest.mark.slow
def test_what_the_file_tells_is_known(recording: torchrbd.Recording, tmp_path: Path) -> None:
    (tmp_path / "arm.xml").write_text(arm(0.4, 20.0, 4.0))
    found = torchrbd.identify(tmp_path / "arm.xml", recording)
    assert found.fits["extended"].mean_nmse < 1e-3 < found.fits["rigid_body"].mean_nmse
    values = {p.name: p.value for p in found.parameters}
    assert values["coulomb_friction_j1.coulomb"] == pytest.approx(1.2, rel=0.05)
    terms = {(t.effect.id, t.site.joint): t.parameters_by_name() for t in found.model.terms}
    assert terms["rotor_inertia", 1]["rotor_inertia"] == pytest.approx(0.4)
    assert terms["joint_spring", 0] == pytest.approx({"stiffness": 20.0, "rest_position": 0.3})
    s = found.series
    np.testing.assert_allclose(s.predicted["extended"], s.measured, atol=0.5)
    assert np.abs(s.measured).max() > 20.0
    (note,) = [n for n in found.notes if n.startswith("rotors and springs")]
    assert str(tmp_path / "arm.xml") in note
    errors = found.simulation[0].errors
    for joint in ("j1", "j2"):
        assert errors["extended"][joint].median < 0.2 * errors["urdf"][joint].median


def test_the_command_writes_all_its_files(recording: torchrbd.Recording, tmp_path: Path) -> None:
    import pyarrow as pa
    from pyarrow import parquet

    chunk = next(iter(recording.chunks(10**6)))
    columns = {
        f"{key}_{n}": x[:, k] for key, x in (("q", chunk.q), ("tau", chunk.tau)) for k, n in enumerate(("j1", "j2"))
    }
    parquet.write_table(pa.table({"t": chunk.t, **columns}), tmp_path / "day.parquet")
    (tmp_path / "arm.xml").write_text(arm(0.4, 20.0, 4.0))
    out = tmp_path / "out"
    assert main(["identify", str(tmp_path / "arm.xml"), str(tmp_path / "day.parquet"), "-o", str(out)]) == 0
    model = torchrbd.load_model(out / "model.safetensors")
    urdf = (out / "identified.urdf").read_text()
    assert "rotor inertia" in urdf
    assert torchrbd.RobotModel.from_urdf(out / "identified.urdf").joint_names == ("j1", "j2")
    again = torchrbd.RigidBodyDynamics.from_urdf(torchrbd.to_mjcf(model))
    q, qd, qdd = torch.randn(3, 20, 2, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    # What a file has of actuators is not read back: the difference of dry friction by direction.
    torch.testing.assert_close(again(q, qd, qdd), model(q, qd, qdd), rtol=0.0, atol=0.05)
    assert json.loads((out / "parameters.json").read_text())["simulation"]
    assert main(["simulate", str(out), str(tmp_path / "day.parquet"), "--seconds", "1", "-o", str(out / "m.csv")]) == 0


@pytest.mark.slow
def test_a_rotor_that_the_file_has_too_small_is_found_on_top(recording: torchrbd.Recording) -> None:
    found = torchrbd.identify(
        arm(0.1, 20.0, 4.0).encode(), recording, effects=["viscous_friction", "coulomb_friction", "rotor_inertia@j2"]
    )
    (value,) = [p.value for p in found.parameters if p.name == "rotor_inertia_j2.rotor_inertia"]
    assert value == pytest.approx(0.3, rel=0.1)


def test_the_regressor_for_scikit_learn_knows_it_too() -> None:
    motion = multisine(2, 6, duration_s=10.0)
    truth = torchrbd.RigidBodyDynamics.from_urdf(arm(0.4, 20.0, 5.0).encode())
    with torch.no_grad():
        tau = truth(*(torch.from_numpy(x) for x in (motion.q, motion.qd, motion.qdd))).numpy()
    X = np.hstack((motion.q, motion.qd, motion.qdd))
    found = torchrbd.DynamicsRegressor(arm(0.4, 20.0, 4.0).encode()).fit(X, tau)
    np.testing.assert_allclose(found.predict(X), tau, atol=1e-2 * np.abs(tau).max())


def simulation(text: str, rate_hz: float) -> torchrbd.Recording:
    """Record the motion of ``recording`` in MuJoCo: rotors, springs and damping are its own."""
    model = mujoco.MjModel.from_xml_string(text)
    data, motion = mujoco.MjData(model), multisine(2, 4, duration_s=30.0, rate_hz=rate_hz)
    tau = []
    for data.qpos[:], data.qvel[:], data.qacc[:] in zip(motion.q, motion.qd, motion.qdd, strict=True):
        mujoco.mj_inverse(model, data)
        tau.append(data.qfrc_inverse.copy())
    return torchrbd.Recording.from_arrays("mujoco", ("j1", "j2"), motion.t, motion.q, np.array(tau))


@pytest.mark.parametrize(("rotor", "rate_hz"), [(0.4, 200.0), (0.1, 500.0)], ids=["of the file", "of its own"])
def test_a_simulation_of_it_stands_for_it(recording: torchrbd.Recording, rotor: float, rate_hz: float) -> None:
    """What the file tells of rotors and springs is in both torques, and taken off both once."""
    simulated = simulation(arm(rotor, 20.0, 4.0), rate_hz)
    effects = [*FRICTION, *(["rotor_inertia@j2"] if rotor != 0.4 else [])]
    found = torchrbd.identify(arm(0.4, 20.0, 4.0).encode(), recording, simulated=simulated, effects=effects)
    values = {p.name: p.value for p in found.parameters}
    assert values["mcx_upper"] + 0.4 * values["m_lower"] == pytest.approx(5.0 * 0.2 + 0.4 * 1.5, rel=0.01)
    assert [values[f"coulomb_friction_{j}.coulomb"] for j in ("j1", "j2")] == pytest.approx([1.2, 1.2], rel=0.05)
    if rotor != 0.4:
        assert values["rotor_inertia_j2.rotor_inertia"] == pytest.approx(0.4 - rotor, rel=0.05)
    assert found.fits["extended"].mean_nmse < min(1e-3, 0.02 * found.fits["urdf"].mean_nmse)
    assert found.doubts == ()
    assert any(note.startswith("compared with the simulation mujoco (for day)") for note in found.notes)


@pytest.mark.slow
def test_a_diagnosis_against_a_simulation_of_it(recording: torchrbd.Recording) -> None:
    """Findings are the difference; the motion is rolled forward with all that the file tells."""
    simulated = simulation(arm(0.4, 20.0, 4.0), 200.0)
    found = torchrbd.diagnose(arm(0.4, 20.0, 4.0).encode(), recording, simulated=simulated, effects=FRICTION)
    assert found.simulated == ("mujoco",)
    assert {(f.effect, f.joints) for f in found.findings} == {("coulomb_friction", (j,)) for j in ("j1", "j2")}
    assert found.statement.startswith("The simulation lacks Coulomb friction at all joints.")
    errors = found.identification.simulation[0].errors
    for joint in ("j1", "j2"):
        assert errors["extended"][joint].median < 0.02 * errors["urdf"][joint].median
