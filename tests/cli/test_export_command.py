"""The command that writes a model for simulators: file out, table of the check, exit codes."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from robot.random_robots import random_urdf
from simulated import multisine

import torchrbd
from torchrbd.cli import main
from torchrbd.effects import Site, Term, effect

TERMS = (("viscous_friction", 0, 0.3), ("rotor_inertia", 1, 0.4))


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with model.safetensors of a robot with a joint "j[/b]", and day.csv of its motion."""
    folder = tmp_path_factory.mktemp("case")
    urdf = random_urdf(21, 2, kinds=("revolute",), branching=0.0, massless=0.0).replace("joint2", "j[/b]")
    robot = torchrbd.RobotModel.from_urdf(urdf)
    terms = [Term(effect(n), Site(j), torch.tensor([w], dtype=torch.float64), {}) for n, j, w in TERMS]
    torchrbd.save_model(torchrbd.RigidBodyDynamics(robot, terms=terms), folder / "model.safetensors")
    motion = multisine(2, 3, duration_s=10.0)
    header = ",".join(["t", *(f"{s}_{n}" for s in ("q", "tau") for n in robot.joint_names)])
    np.savetxt(
        folder / "day.csv",
        np.column_stack((motion.t, motion.q, motion.q)),
        delimiter=",",
        header=header,
        comments="",
    )
    return folder


def told(capsys: pytest.CaptureFixture[str]) -> str:
    return re.sub(r"\s+", " ", capsys.readouterr().out)


def test_the_file_is_what_the_function_writes(case: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    model, file = torchrbd.load_model(case / "model.safetensors"), tmp_path / "new" / "arm.xml"
    assert main(["export", str(case), "--to", "mjcf", "-o", str(file)]) == 0
    assert file.read_bytes() == torchrbd.to_mjcf(model)
    words = told(capsys)
    assert f"wrote {file}" in words
    for sentence in torchrbd.not_exported(model):
        assert f"- {sentence}" in words
    assert "beside the model" not in words


def test_without_a_name_the_file_lies_beside_the_model(case: Path, tmp_path: Path) -> None:
    copied = tmp_path / "model.safetensors"
    copied.write_bytes((case / "model.safetensors").read_bytes())
    assert main(["export", str(copied), "--to", "urdf"]) == 0
    assert main(["export", str(tmp_path), "--to", "mjcf"]) == 0
    assert (tmp_path / "model.urdf").read_bytes() == torchrbd.to_urdf(torchrbd.load_model(copied))
    assert {path.name for path in tmp_path.iterdir()} == {"model.safetensors", "model.urdf", "model.xml"}


def test_check_shows_each_joint(case: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("mujoco")
    shown = {}
    for to in ("mjcf", "urdf"):
        check = ["--check", str(case / "day.csv"), "--cutoff", "5"]
        assert main(["export", str(case), "--to", to, "-o", str(tmp_path / to), *check]) == 0
        shown[to] = told(capsys)
        assert "motion band-limited at 5 Hz" in shown[to]
    joint = r"│ {} │ [0-9.]+ N m │ ([0-9.]+(·10⁻[¹²³⁴⁵⁶⁷⁸⁹⁰]+)?) N m │ ([<0-9. ]+) % │"
    for to, name, same in (("mjcf", "joint1", True), ("mjcf", "j[/b]", True), ("urdf", "joint1", True)):
        row = re.search(joint.format(re.escape(name)), shown[to])
        assert row
        assert (row[3] == "< 0.001") == same
    row = re.search(joint.format(re.escape("j[/b]")), shown["urdf"])
    assert row
    assert float(row[3]) > 1
    assert "rotor inertia (armature) at j[/b] (rotor_inertia 0.4 N m s^2/rad): URDF has no word for it" in shown["urdf"]


def test_bad_input_is_told_with_its_remedy(
    case: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "text.safetensors").write_text("no model")
    (tmp_path / "short.csv").write_text("t,q_joint1\n0,0\n")
    out = ["--to", "mjcf", "-o", str(tmp_path / "out.xml")]
    bad = {
        "holds no model.safetensors; give the folder": [str(tmp_path / "empty"), *out],
        "none.safetensors: cannot be read as a model": [str(tmp_path / "none.safetensors"), *out],
        "text.safetensors: cannot be read as a model": [str(tmp_path / "text.safetensors"), *out],
        "is a folder; name a file": [str(case), "--to", "mjcf", "-o", str(tmp_path / "empty")],
        "of the recordings that --check names": [str(case), *out, "--cutoff", "5"],
        "dawn.csv": [str(case), *out, "--check", str(tmp_path / "dawn.csv")],
        "short.csv": [str(case), *out, "--check", str(tmp_path / "short.csv")],
        "map.yaml": [str(case), *out, "--check", str(case / "day.csv"), "--mapping", str(tmp_path / "map.yaml")],
        "too high": [str(case), *out, "--check", str(case / "day.csv"), "--cutoff", "90"],
    }
    for words, arguments in bad.items():
        assert main(["export", *arguments]) == 2
        answer = re.sub(r"\s+", " ", capsys.readouterr().err)
        assert answer.startswith("torchrbd: error: ")
        assert words in answer
        assert "Traceback" not in answer
    monkeypatch.setitem(sys.modules, "mujoco", None)
    assert main(["export", str(case), *out, "--check", str(case / "day.csv")]) == 2
    assert "MuJoCo is not installed: pip install mujoco" in capsys.readouterr().err
    assert not (tmp_path / "out.xml").exists()
