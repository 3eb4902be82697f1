"""The command that identifies each recording on its own: a folder each, one table, and what failed told at the end."""

from __future__ import annotations

import json
import os
import re
import signal
from pathlib import Path

import numpy as np
import pytest
from inference.problems import urdf_of
from simulated import joint_names, record

import torchrbd
from torchrbd._runtime import deadline
from torchrbd.cli import main
from torchrbd.inference import many
from torchrbd.report.text.numbers import number

pytestmark = pytest.mark.usefixtures("fit_alone", "without_joint_figures")

URDF = urdf_of(2, 2)
FILES = {"parameters.json", "identified.urdf", "model.safetensors", "report.html"}


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with arm.urdf, day[1].npz and night.npz, and torn.csv, which has no torque."""
    folder = tmp_path_factory.mktemp("case")
    (folder / "arm.urdf").write_text(URDF)
    for seed, name in enumerate(("day[1]", "night")):
        (chunk,) = record(URDF, seed, duration_s=12.0).chunks(10**6)
        np.savez(folder / f"{name}.npz", t=chunk.t, q=chunk.q, tau=chunk.tau, joints=np.array(joint_names(URDF)))
    (folder / "torn.csv").write_text("t,q_joint1,q_joint2\n0,0,0\n")
    return folder


def run(case: Path, output: Path, *recordings: str, options: tuple[str, ...] = ()) -> int:
    files = [str(case / name) for name in ("arm.urdf", *recordings)]
    return main(["identify", *files, "--each", "-q", "-o", str(output), "--cutoff", "5", *options])


def test_each_recording_has_its_folder_and_its_row(
    case: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "out"
    assert run(case, output, "day[1].npz", "night.npz", options=("-j", "1")) == 0
    told = capsys.readouterr()
    assert all(line.startswith("torchrbd: ") and " s, " in line for line in told.err.splitlines())
    assert {path.name for path in output.iterdir()} == {"day[1]", "night"}
    digits, rows = r"([\d.·⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+)", {}
    for found in re.finditer(rf"│ (\S+) +│ (\w+) +│ +{digits} │ +{digits} │ +[\d.]+ s │", told.out):
        rows[found[1]] = found.groups()[1:]
    assert list(rows) == ["day[1].npz", "night.npz"]
    for name in ("day[1]", "night"):
        assert {path.name for path in (output / name).iterdir()} == FILES
        alone = torchrbd.identify(case / "arm.urdf", case / f"{name}.npz", cutoff_hz=5.0)
        written = json.loads((output / name / "parameters.json").read_text())
        assert written["recordings"] == [f"{name}.npz"]
        assert [p["value"] for p in written["parameters"]] == [p.value for p in alone.parameters]
        fits = [alone.fits[key].mean_nmse for key in ("urdf", "extended")]
        assert rows[f"{name}.npz"] == (alone.verdict, *map(number, fits))
    assert f"to {output}/<recording>" in told.out


def test_the_rest_is_done_and_what_failed_is_told_with_exit_code_two(
    case: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recordings = ("torn.csv", "night.npz", "dawn.csv")
    assert run(case, tmp_path, *recordings, options=("-j", "1", "--effects", "viscous_friction")) == 2
    told = capsys.readouterr()
    assert {path.name for path in tmp_path.iterdir()} == {"night"}
    cells = [[cell.strip() for cell in line.split("│")[1:-1]] for line in told.out.splitlines() if line[:1] == "│"]
    assert [(cell[0], cell[1] == "failed") for cell in cells] == [
        ("torn.csv", True),
        ("night.npz", False),
        ("dawn.csv", True),
    ]
    assert cells[0][2:4] == ["–", "–"]
    first, *reasons = told.err.splitlines()
    assert first == "torchrbd: error: 2 of 3 recordings could not be identified"
    assert len(reasons) == 2
    for reason, name in zip(reasons, ("torn.csv", "dawn.csv"), strict=True):
        assert reason.startswith(f"  {case / name}: ")
        assert reason.count(name) == 1


def test_nothing_is_said_to_be_written_where_all_failed(
    case: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(case, tmp_path / "out", "dawn.csv") == 2
    assert "wrote" not in capsys.readouterr().out
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("other", ["day[1].csv", "sub/day[1].npz", "Day[1].npz", "day[1].npz"])
def test_two_recordings_for_one_folder_are_refused_before_any_work(
    other: str, case: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(case, tmp_path / "out", "day[1].npz", other) == 2
    told = capsys.readouterr()
    assert f"'{case / 'day[1].npz'}' and '{case / other}' would both be written" in told.err
    assert (told.out, (tmp_path / "out").exists()) == ("", False)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("-j", "0"), "jobs is 0; expected a whole number"),
        (("--joints", "jointX"), "no moving joint 'jointX'"),
        (("--config", "none.yaml"), "none.yaml: cannot be read"),
    ],
)
def test_options_that_fail_for_all_are_told_once(
    options: tuple[str, ...], words: str, case: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(case, tmp_path / "out", "day[1].npz", "night.npz", options=options) == 2
    told = capsys.readouterr()
    assert told.err.startswith("torchrbd: error: ")
    assert told.err.count(words) == 1
    assert told.out == ""


def test_processes_are_for_each(case: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files = [str(case / "arm.urdf"), str(case / "night.npz")]
    assert main(["identify", *files, "-o", str(tmp_path / "out"), "-j", "2"]) == 2
    assert "-j is for --each" in capsys.readouterr().err


@pytest.mark.parametrize("kind", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_keeps_what_is_done_and_begins_no_more(
    kind: signal.Signals,
    case: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    """It comes in the first of three: that one is ended early and written, and the others are not begun."""
    usual, calls = many.identify, []

    def interrupted(robot, sources, **options):
        calls.append(sources)
        os.kill(os.getpid(), kind)
        return usual(robot, sources, **options)

    monkeypatch.setattr(many, "identify", interrupted)
    for name in ("noon", "dawn"):
        (tmp_path / f"{name}.npz").write_bytes((case / "night.npz").read_bytes())
    others = [str(tmp_path / f"{name}.npz") for name in ("noon", "dawn")]
    assert run(case, tmp_path / "out", "night.npz", *others, options=("-j", "1", "--effects", "stribeck_friction")) == 0
    assert calls == [case / "night.npz"]
    told = capfd.readouterr()
    assert "finishing with what was found" in told.err
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"night"}
    content = json.loads((tmp_path / "out" / "night" / "parameters.json").read_text())
    assert content["finished"] is False
    assert any("because you asked for it" in note for note in content["notes"])
    cells = [[cell.strip() for cell in line.split("│")[1:3]] for line in told.out.splitlines() if line[:1] == "│"]
    assert cells == [
        ["night.npz", f"{content['verdict']} (unfinished)"],
        ["noon.npz", "not begun"],
        ["dawn.npz", "not begun"],
    ]
    assert "unfinished: 2 of 3 recordings were not begun" in told.out
    assert not deadline.asked_for()


def test_the_time_limit_is_for_each(case: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Both have ended at the limit; one limit for the whole would have left nothing of the second."""
    options = ("-j", "1", "--effects", "stribeck_friction", "--time-limit", "0.01s")
    assert run(case, tmp_path, "day[1].npz", "night.npz", options=options) == 0
    assert capsys.readouterr().out.count("(unfinished)") == 2
    for name in ("day[1]", "night"):
        content = json.loads((tmp_path / name / "parameters.json").read_text())
        assert any("at the time limit of 0.01 s" in note for note in content["notes"])
    main(["identify", "--help"])
    assert "--time-limit is for each" in " ".join(capsys.readouterr().out.split())
