"""One recording anew: from Python and on the command line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
import torch
from pyarrow import parquet
from robot.random_robots import random_urdf
from simulated import multisine, record

import torchrbd
from torchrbd.cli import main
from torchrbd.effects import Site, Term, effect
from torchrbd.model import RigidBodyDynamics

pytestmark = pytest.mark.usefixtures("fit_alone")

URDF = random_urdf(21, 2, kinds=("revolute", "prismatic"), branching=0.0, massless=0.0)


@pytest.fixture(scope="module")
def model() -> RigidBodyDynamics:
    return RigidBodyDynamics.from_urdf(URDF.encode())


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with arm.urdf, its model.safetensors, and day.parquet of ten seconds."""
    folder = tmp_path_factory.mktemp("case")
    (folder / "arm.urdf").write_text(URDF)
    RigidBodyDynamics.from_urdf(URDF.encode()).save(folder / "model.safetensors")
    given = record(URDF, 5, torque_noise=0.0, encoder_noise=0.0, duration_s=10.0)
    chunk = next(iter(given.chunks(10**6)))
    columns = {
        f"{key}_{n}": x[:, k] for key, x in (("q", chunk.q), ("tau", chunk.tau)) for k, n in enumerate(given.joints)
    }
    parquet.write_table(pa.table({"t": chunk.t, **columns}), folder / "day.parquet")
    return folder


def test_the_true_model_follows_the_recording(model: RigidBodyDynamics, case: Path) -> None:
    found = torchrbd.simulate(model, case / "day.parquet", start=2.0, seconds=1.0)
    assert found.t[0] == 2.0
    assert found.t[-1] == pytest.approx(3.0)
    assert len(found.t) == 201
    assert np.ptp(found.recorded, axis=0).min() > 0.1
    np.testing.assert_allclose(found.q, found.recorded, atol=2e-3 * np.ptp(found.recorded))
    moved = multisine(2, 5, duration_s=10.0)
    np.testing.assert_allclose(found.recorded, moved.q[400:601], atol=1e-4)


def test_a_model_can_be_trained_after_it_was_simulated(case: Path) -> None:
    """Simulation works on a copy: it once froze the friction of every identified model."""
    model = RigidBodyDynamics.from_urdf(URDF.encode(), effects=["viscous_friction"])
    torchrbd.simulate(model, case / "day.parquet", start=1.0, seconds=0.1)
    assert len(model.terms) > 0
    assert all(parameter.requires_grad for parameter in model.parameters())


def test_rates_are_those_asked_for_and_change_little(model: RigidBodyDynamics, case: Path) -> None:
    coarse, fine = (
        torchrbd.simulate(model, case / "day.parquet", start=2.0, seconds=1.0, rate_hz=rate) for rate in (20.0, 1000.0)
    )
    assert len(coarse.t) == 21
    np.testing.assert_allclose(coarse.q, fine.q[::50], atol=1e-3)


@pytest.mark.parametrize("suffix", [".parquet", ".csv", ".npz"])
def test_what_is_written_is_read_again(model: RigidBodyDynamics, case: Path, tmp_path: Path, suffix: str) -> None:
    found = torchrbd.simulate(model, case / "day.parquet", start=2.0, seconds=0.5)
    found.write(tmp_path / f"simulated{suffix}")
    opened = torchrbd.open_recording(tmp_path / f"simulated{suffix}", model.robot.joint_names)
    chunk = next(iter(opened.chunks()))
    np.testing.assert_allclose(chunk.t, found.t - found.t[0], atol=1e-12)
    for read, given in ((chunk.q, found.q), (chunk.qd, found.qd), (chunk.tau, found.tau)):
        np.testing.assert_allclose(read, given, atol=1e-12)
    assert opened.has_velocity


def test_what_a_model_makes_is_what_identification_finds(case: Path) -> None:
    """A motion made with friction, read by ``identify`` with the URDF that lacks it."""
    robot = torchrbd.RobotModel.from_urdf(URDF.encode())
    friction = Term(effect("viscous_friction"), Site(0), torch.tensor([2.0], dtype=torch.float64), {})
    made = torchrbd.simulate(RigidBodyDynamics(robot, terms=[friction]), case / "day.parquet", rate_hz=200.0)
    found = torchrbd.identify(robot, made.recording())
    values = {p.name: p.value for p in found.parameters if p.status == "term"}
    assert values[f"viscous_friction_{robot.joint_names[0]}.viscous"] == pytest.approx(2.0, rel=0.05)


def test_what_cannot_be_done_is_told(model: RigidBodyDynamics, case: Path) -> None:
    with pytest.raises(torchrbd.RecordingError, match=r"nothing at 50 s or after it .* it has 0\.\d+ to 9\.\d+ s"):
        torchrbd.simulate(model, case / "day.parquet", start=50.0)
    with pytest.raises(torchrbd.OptionError, match="seconds is -1; expected more than zero"):
        torchrbd.simulate(model, case / "day.parquet", seconds=-1.0)
    silent = {"t": np.arange(1000) / 100.0, **{f"q_{n}": np.sin(np.arange(1000) / 50) for n in model.robot.joint_names}}
    with pytest.raises(torchrbd.RecordingError):
        torchrbd.simulate(model, silent)


def test_the_command(case: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    given = [str(case / "day.parquet"), "--from", "2", "--seconds", "0.5"]
    for k, source in enumerate((case / "arm.urdf", case / "model.safetensors", case)):
        assert main(["simulate", str(source), *given, "-o", str(tmp_path / "new" / f"{k}.csv")]) == 0
        assert f"wrote {tmp_path / 'new' / f'{k}.csv'}" in capsys.readouterr().out
    assert (tmp_path / "new" / "1.csv").read_bytes() == (tmp_path / "new" / "2.csv").read_bytes()
    for arguments, words in (
        (["-o", "x.txt"], "output 'x.txt': expected a file that ends in .parquet, .csv, .npz"),
        (["-o", "x.csv", "--gravity", "0", "0", "1"], "has its own"),
    ):
        assert main(["simulate", str(case), *given, *arguments]) == 2
        assert words in " ".join(capsys.readouterr().err.split())
