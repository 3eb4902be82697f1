"""The command that designs a motion: files out, table, exit codes."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml
from excitation.arms import arm_urdf

import torchrbd
from torchrbd.cli import main


@pytest.fixture
def robot(tmp_path: Path) -> str:
    file = tmp_path / "arm.urdf"
    file.write_text(arm_urdf().replace("joint3", "j[3]"))
    return str(file)


def told(capsys: pytest.CaptureFixture[str]) -> str:
    return re.sub(r"\s+", " ", capsys.readouterr().out)


def test_samples_are_those_of_the_series_beside_them(
    robot: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "new" / "motion.csv"
    options = ["--rate", "40", "--periods", "2", "--frequency", "0.2", "--harmonics", "3", "--starts", "1"]
    limits = ["--range", "joint1=-1:1", "--velocity", "j[3]=1.5", "--effort", "joint2=55", "--box", "z=0.05:", "x=:0.9"]
    assert main(["excite", robot, "-o", str(file), *options, *limits, "--speed", "0.8"]) == 0
    table, series = pd.read_csv(file), yaml.safe_load(file.with_suffix(".yaml").read_text())
    assert list(table) == ["t", *(f"{s}_{j}" for s in ("q", "qd", "qdd") for j in ("joint1", "joint2", "j[3]"))]
    assert len(table) == 401
    np.testing.assert_allclose(table.t, np.arange(401) / 40.0, atol=1e-9)
    assert (series["period_s"], series["periods"]) == (5.0, 2)
    for joint, one in series["joints"].items():
        angle = np.outer(table.t, 2 * np.pi * np.arange(1, 4) / series["period_s"])
        q = one["centre"] + np.sin(angle) @ one["sine"] + np.cos(angle) @ one["cosine"]
        np.testing.assert_allclose(table[f"q_{joint}"], q, atol=1e-7)
        for a, b in (("q", "qd"), ("qd", "qdd")):
            slope = np.gradient(table[f"{a}_{joint}"], table.t, edge_order=2)
            np.testing.assert_allclose(table[f"{b}_{joint}"], slope, atol=0.03 * np.abs(slope).max())
    assert table.q_joint1.abs().max() <= 0.9
    assert table["qd_j[3]"].abs().max() <= 0.9 * 0.8 * 1.5
    assert series["box"] == {"x": [None, 0.9], "z": [0.05, None]}
    assert series["options"]["ranges"] == {"joint1": [-1.0, 1.0]}
    assert series["condition_number"]["scaled"] == pytest.approx(series["condition_number"]["scaled"])
    words = told(capsys)
    assert "condition number of the regressor of 15 base parameters" in words
    assert "│ j[3] │" in words
    assert f"wrote {file} and {file.with_suffix('.yaml')}" in words


def test_the_command_designs_what_the_function_designs(robot: str, tmp_path: Path) -> None:
    file = tmp_path / "motion.csv"
    assert main(["excite", robot, "-o", str(file), "--harmonics", "2", "--starts", "1", "--seed", "5"]) == 0
    result = torchrbd.excite(robot, harmonics=2, starts=1, seed=5)
    found = np.loadtxt(file, delimiter=",", skiprows=1)
    np.testing.assert_allclose(found, np.column_stack(result.states()), atol=1e-7)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--range", "joint1"], "--range: expected JOINT=LOW:HIGH, e.g. joint2=-1:1.5, got 'joint1'"),
        (["--range", "joint1=1"], "--range: expected JOINT=LOW:HIGH, e.g. joint2=-1:1.5, got 'joint1=1'"),
        (["--range", "joint1=:1"], "--range: expected JOINT=LOW:HIGH, e.g. joint2=-1:1.5, got 'joint1=:1'"),
        (["--box", "z=low:"], "--box: expected AXIS=LOW:HIGH, e.g. z=0.05: or x=-0.4:0.6, got 'z=low:'"),
        (["--velocity", "joint1=fast"], "--velocity: expected JOINT=NUMBER, e.g. joint2=1.5, got 'joint1=fast'"),
        (["--joints", "elbow"], "robot 'arm' has no joint 'elbow'"),
        (["--rate", "0"], "rate is 0 Hz; expected a positive number"),
        (["--harmonics", "1"], "harmonics is 1; expected at least 2"),
        (["-d", "nowhere"], "cannot be read"),
    ],
)
def test_what_cannot_be_used_is_told(
    robot: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], words: str
) -> None:
    file = tmp_path / "motion.csv"
    assert main(["excite", robot, "-o", str(file), *arguments]) == 2
    assert words in capsys.readouterr().err
    assert not file.exists()


@pytest.mark.parametrize("name", ["motion.txt", "motion", "."])
def test_the_output_is_a_csv_file(robot: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str) -> None:
    assert main(["excite", robot, "-o", str(tmp_path / name)]) == 2
    assert "is no CSV file; name one, e.g." in capsys.readouterr().err


def test_a_robot_without_limits_is_told_at_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "free.urdf"
    file.write_text(arm_urdf(limits=False))
    assert main(["excite", str(file), "-o", str(tmp_path / "motion.csv")]) == 2
    assert "joint 'joint1' has no lower and upper limit (--range joint1=-3.1:3.1)" in capsys.readouterr().err
