"""Drives that follow set-points: against MuJoCo, one window and many, and what is refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pandas as pd
import pytest
import torch
from likelihood.arms import arm_urdf, driven_columns
from simulated import joint_names

import torchrbd
from torchrbd.cli import main
from torchrbd.dataset.block_statistics import Block
from torchrbd.dataset.reading import Reading
from torchrbd.effects import Site, Term, effect
from torchrbd.errors import RecordingError
from torchrbd.inference.preparation import read
from torchrbd.inference.settings import Settings
from torchrbd.model import RigidBodyDynamics
from torchrbd.recordings import open_recording, read_mapping
from torchrbd.simulation import closed_loop
from torchrbd.simulation.closed_loop import _by_joint, set_points

pytestmark = pytest.mark.usefixtures("fit_alone")

URDF = arm_urdf(0, 2)
KP, KD, VISCOUS, ROTOR = np.array([60.0, 25.0]), np.array([2.0, 0.8]), np.array([0.4, 0.2]), np.array([0.2, 0.05])


def mapping_text(limit: float | None = None, delay_s: float = 0.0) -> str:
    own = "" if limit is None else f", limit: {limit}"
    lines = [f"  {n}: {{drive: {{kp: {p}, kd: {d}{own}}}}}" for n, p, d in zip(joint_names(URDF), KP, KD, strict=True)]
    return "\n".join([f"set_point_delay: {delay_s}", "joints:", *lines])


def true_model() -> RigidBodyDynamics:
    robot = RigidBodyDynamics.from_urdf(URDF.encode()).robot
    terms = [
        Term(effect(name), Site(j), torch.tensor([float(size[j])], dtype=torch.float64), {})
        for j in range(2)
        for name, size in (("viscous_friction", VISCOUS), ("rotor_inertia", ROTOR))
    ]
    return RigidBodyDynamics(robot, terms=terms)


def torque(m) -> np.ndarray:
    return VISCOUS * m.qd + ROTOR * m.qdd


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with day.csv, of ten seconds, and map.yaml."""
    folder = tmp_path_factory.mktemp("case")
    columns = driven_columns(
        URDF, 3, torque, KP, KD, delay_s=0.01, encoder_noise=0.0, torque_noise=0.0, duration_s=10.0, rate_hz=200.0
    )
    pd.DataFrame(columns).to_csv(folder / "day.csv", index=False)
    (folder / "map.yaml").write_text(mapping_text(delay_s=0.01))
    return folder


def in_mujoco(case: Path, t: np.ndarray, q: np.ndarray, qd: np.ndarray, limit: float = np.inf) -> np.ndarray:
    """Return the positions (N, 2) of MuJoCo under the same set-points, at times (N,), from one state on."""
    m = mujoco.MjModel.from_xml_string(URDF)
    m.opt.timestep, m.dof_damping[:], m.dof_armature[:] = 1e-4, VISCOUS, ROTOR
    m.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_LIMIT
    d = mujoco.MjData(m)
    d.qpos[:], d.qvel[:] = q, qd
    opened = open_recording(case / "day.csv", joint_names(URDF), mapping=read_mapping(case / "map.yaml"))
    steps = round((t[-1] - t[0]) / 1e-4)
    wanted, path = set_points(opened, t[0] + 1e-4 * np.arange(steps)), [q]
    for k in range(steps):
        d.qfrc_applied[:] = np.clip(KP * (wanted[k] - d.qpos) - KD * d.qvel, -limit, limit)
        mujoco.mj_step(m, d)
        path.append(d.qpos.copy())
    return np.array(path)[np.round((t - t[0]) / 1e-4).astype(int)]


@pytest.mark.parametrize("limit", [None, 6.0])
def test_the_exported_file_follows_the_same_commands(case: Path, limit: float | None) -> None:
    """Actuators of the file take set-points: MuJoCo alone makes the motion of the model."""
    (case / "own.yaml").write_text(mapping_text(limit, delay_s=0.01))
    model = true_model()
    opened = open_recording(case / "day.csv", joint_names(URDF), mapping=read_mapping(case / "own.yaml"))
    model.drives = replace(opened.drives, delay_s=0.0)
    found = torchrbd.simulate(model, opened, start=1.0, seconds=3.0, commands=True)
    m = mujoco.MjModel.from_xml_string(torchrbd.to_mjcf(model).decode())
    m.opt.timestep = 1e-4
    m.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_LIMIT
    d = mujoco.MjData(m)
    d.qpos[:], d.qvel[:] = found.q[0], found.qd[0]
    steps, path = round((found.t[-1] - found.t[0]) / 1e-4), [found.q[0]]
    for wanted in set_points(opened, found.t[0] + 1e-4 * np.arange(steps)):
        d.ctrl[:] = wanted
        mujoco.mj_step(m, d)
        path.append(d.qpos.copy())
    other = np.array(path)[np.round((found.t - found.t[0]) / 1e-4).astype(int)]
    moved = np.sqrt(np.mean((other - other.mean(0)) ** 2, 0))
    assert (np.sqrt(np.mean((found.q - other) ** 2, 0)) < 1e-3 * moved).all()


@pytest.mark.parametrize("limit", [None, 6.0])
def test_the_motion_is_that_of_mujoco(case: Path, tmp_path: Path, limit: float | None) -> None:
    (tmp_path / "map.yaml").write_text(mapping_text(limit, delay_s=0.01))
    found = torchrbd.simulate(
        true_model(), case / "day.csv", start=1.0, seconds=3.0, commands=True, mapping=tmp_path / "map.yaml"
    )
    other = in_mujoco(case, found.t, found.q[0], found.qd[0], np.inf if limit is None else limit)
    moved = np.sqrt(np.mean((other - other.mean(0)) ** 2, 0))
    assert (np.sqrt(np.mean((found.q - other) ** 2, 0)) < 1e-3 * moved).all()
    if limit is not None:
        assert np.abs(found.tau).max() == limit


def test_the_true_model_follows_the_recording(case: Path) -> None:
    found = torchrbd.simulate(true_model(), case / "day.csv", start=1.0, commands=True, mapping=case / "map.yaml")
    for joint, (recorded, simulated) in found.tracking.items():
        assert found.distance[joint] < 0.01 * recorded
        assert simulated == pytest.approx(recorded, rel=0.01)
    wrong = torchrbd.simulate(
        RigidBodyDynamics.from_urdf(URDF.encode()), case / "day.csv", start=1.0, commands=True,
        mapping=case / "map.yaml",
    )  # fmt: skip
    assert min(wrong.distance[j] / found.distance[j] for j in found.joints) > 10


def reading_of(case: Path) -> Reading:
    model = RigidBodyDynamics.from_urdf(URDF.encode())
    settings = Settings.from_mapping({"mapping": case / "map.yaml"}, "test")
    return read(model.robot, [case / "day.csv"], settings)[0]


def test_windows_together_are_those_alone(case: Path) -> None:
    blocks = [Block("day.csv", a, b) for a, b in ((1.0, 3.0), (5.0, 6.0))]
    reading, models = reading_of(case), {"urdf": RigidBodyDynamics.from_urdf(URDF.encode()), "extended": true_model()}
    both, _ = closed_loop(reading, blocks, [True, True], models)
    one, _ = closed_loop(reading, blocks, [True, False], models)
    other, _ = closed_loop(reading, blocks, [False, True], models)
    assert both is not None
    assert one is not None
    assert other is not None
    assert both.seconds == pytest.approx(one.seconds + other.seconds) == pytest.approx(3.0)
    for name in models:
        for joint, x in both.errors[name].items():
            squares = 2 * one.errors[name][joint] ** 2 + other.errors[name][joint] ** 2
            assert x == pytest.approx(np.sqrt(squares / 3), rel=1e-9)
    assert max(both.errors["extended"][j] / both.errors["urdf"][j] for j in both.tracking) < 0.1
    assert all(both.errors["urdf"][j] < x for j, x in both.tracking.items())


def test_without_drives_there_is_no_closed_loop(case: Path, tmp_path: Path) -> None:
    columns = {n: x for n, x in pd.read_csv(case / "day.csv").items() if not str(n).startswith("q_ref")}
    pd.DataFrame(columns | {f"tau_{n}": np.sin(columns["t"]) for n in joint_names(URDF)}).to_csv(tmp_path / "a.csv")
    with pytest.raises(RecordingError, match=r"no joint has a drive that follows set-points; give --mapping"):
        torchrbd.simulate(true_model(), tmp_path / "a.csv", commands=True)


def test_on_the_command_line(case: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    true_model().save(tmp_path / "model.safetensors")
    given = [tmp_path / "model.safetensors", case / "day.csv", "--commands", "--mapping", case / "map.yaml"]
    assert main(["simulate", *map(str, given), "--seconds", "1", "-o", str(tmp_path / "out.csv")]) == 0
    said = capsys.readouterr().out
    assert "tracking error" in said
    assert {f"tau_{n}" for n in joint_names(URDF)} <= set(pd.read_csv(tmp_path / "out.csv").columns)


def test_a_joint_whose_torque_never_changes_has_no_error(case: Path, tmp_path: Path) -> None:
    """Its drive holds it at its set-point: nothing is measured there, as at any constant torque."""
    first, second = joint_names(URDF)
    still = pd.read_csv(case / "day.csv")
    still[f"q_{second}"] = still[f"q_ref_{second}"] = 0.3
    still[f"qd_{second}"] = 0.0
    still.to_csv(tmp_path / "day.csv", index=False)
    (tmp_path / "map.yaml").write_text(mapping_text())
    blocks = [Block("day.csv", 1.0, 2.0)]
    found, _ = closed_loop(reading_of(tmp_path), blocks, [True], {"urdf": RigidBodyDynamics.from_urdf(URDF.encode())})
    assert found is not None
    assert set(found.errors["urdf"]) == set(found.tracking) == {first}


def test_a_recording_without_a_joint_does_not_hide_its_error() -> None:
    parts = [torch.tensor([[3.0, torch.nan]]), torch.tensor([[3.0, 4.0]])]
    assert _by_joint(parts, ["a", "b"]) == {"a": 3.0, "b": 4.0}
