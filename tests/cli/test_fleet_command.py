"""The command for a fleet: a folder for each robot, who differs, resuming, and what failed."""

from __future__ import annotations

import dataclasses
import json
import os
import shutil
import signal
from pathlib import Path

import numpy as np
import pytest
from inference.problems import urdf_of
from simulated import Motion, joint_names, record

from torchrbd.cli import fleet, main

URDF = urdf_of(2, 2)
ROBOTS = 7


def write(path: Path, seed: int, viscous: float = 0.4) -> None:
    """Record an arm with friction."""

    def friction(motion: Motion) -> np.ndarray:
        return motion.qd * [viscous, 0.4]

    (chunk,) = record(URDF, seed, extra=friction, duration_s=12.0).chunks(10**6)
    np.savez(path, t=chunk.t, q=chunk.q, tau=chunk.tau, joints=np.array(joint_names(URDF)))


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with robots.yaml, the last of which has twice the viscous friction at its first joint, and its results.

    Moments are enough here, and quick.
    """
    folder = tmp_path_factory.mktemp("fleet")
    (folder / "arm.urdf").write_text(URDF)
    lines = ["options: {estimator: moments, effects: viscous_friction}", "robots:"]
    for k in range(ROBOTS):
        write(folder / f"arm{k}.npz", k, 0.8 if k == ROBOTS - 1 else 0.4)
        lines.append(f"  - {{name: arm{k}, urdf: arm.urdf, recordings: arm{k}.npz}}")
    (folder / "robots.yaml").write_text("\n".join(lines))
    assert main(["fleet", str(folder / "robots.yaml"), "-o", str(folder / "out"), "-j", "1"]) == 0
    return folder


def members(folder: Path) -> dict[str, dict]:
    return {one["name"]: one for one in json.loads((folder / "fleet.json").read_text())["members"]}


def test_the_robot_that_differs_is_told(case: Path) -> None:
    found = members(case / "out")
    told = {name: [d["parameter"] for d in one["deviations"]] for name, one in found.items() if one["deviations"]}
    joint = joint_names(URDF)[0]
    assert told == {f"arm{ROBOTS - 1}": [f"viscous_friction_{joint}.viscous"]}
    assert {path.name for path in (case / "out" / "arm0").iterdir()} == {
        "parameters.json", "identified.urdf", "model.safetensors", "made_from.json",
    }  # fmt: skip
    assert (case / "out" / "fleet.html").is_file()


def test_what_is_there_is_not_identified_again_and_failures_do_not_stop_others(
    case: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = {k: (case / "out" / f"arm{k}" / "parameters.json").stat().st_mtime_ns for k in range(ROBOTS)}
    listed = case / "more.yaml"
    gone, torn = (
        f"\n  - {{name: {file[:4]}, urdf: arm.urdf, recordings: {file}}}" for file in ("gone.npz", "torn.csv")
    )
    listed.write_text((case / "robots.yaml").read_text() + gone + torn)
    (case / "torn.csv").write_text("t,q_joint1\n0,0\n")
    write(case / "arm1.npz", 31)
    assert main(["fleet", str(listed), "-o", str(case / "out"), "-j", "1"]) == 2
    told = capsys.readouterr()
    assert "2 of 9 robots could not be identified" in told.err
    assert "gone.npz: No such file or directory" in told.err
    assert "torn: " in told.err
    after = {k: (case / "out" / f"arm{k}" / "parameters.json").stat().st_mtime_ns for k in range(ROBOTS)}
    assert [k for k in range(ROBOTS) if after[k] != before[k]] == [1]
    assert [name for name, one in members(case / "out").items() if one["verdict"] == "failed"] == ["gone", "torn"]


def test_what_changed_since_an_earlier_time(case: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = (case / "robots.yaml").read_text()
    write(tmp_path / "arm2.npz", 42, 0.6)
    listed = tmp_path / "robots.yaml"
    listed.write_text(text.replace("urdf: ", f"urdf: {case}/").replace("recordings: arm", f"recordings: {case}/arm"))
    listed.write_text(listed.read_text().replace(f"{case}/arm2.npz", "arm2.npz"))
    out = tmp_path / "out"
    assert main(["fleet", str(listed), "-o", str(out), "-j", "1", "--before", str(case / "out")]) == 0
    changed = {name: list(one["changes"]) for name, one in members(out).items() if one["changes"]}
    assert changed == {"arm2": [f"viscous_friction_{joint_names(URDF)[0]}.viscous"]}
    assert "1 changed" in capsys.readouterr().out
    assert main(["fleet", str(listed), "-o", str(out), "--before", str(tmp_path / "none")]) == 2
    assert "expected the folder of an earlier 'torchrbd fleet -o'" in capsys.readouterr().err


def test_results_that_are_gone_are_made_again(case: Path) -> None:
    made = case / "out" / "arm3"
    for name in ("parameters.json", "identified.urdf", "model.safetensors"):
        (made / name).unlink()
        assert main(["fleet", str(case / "robots.yaml"), "-o", str(case / "out"), "-j", "1"]) == 0
        assert (made / name).is_file()


def test_results_that_cannot_be_read_are_one_robots_failure(
    case: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, then = tmp_path / "out", tmp_path / "then"
    for folder in (out, then):
        shutil.copytree(case / "out", folder)
    (out / "arm3" / "parameters.json").write_text("{")
    (then / "arm2" / "parameters.json").write_text("{")
    command = ["fleet", str(case / "robots.yaml"), "-o", str(out), "-j", "1", "--before", str(then)]
    assert main(command) == 2
    told = capsys.readouterr().err
    assert f"1 of {ROBOTS} robots could not be identified" in told
    assert "arm3: " in told
    assert "parameters.json: is not JSON" in told
    found = members(out)
    assert [name for name, one in found.items() if one["error"]] == ["arm3"]
    assert [name for name, one in found.items() if one["changes"] is None] == ["arm2", "arm3"]
    assert "arm2/parameters.json: is not JSON" in found["arm2"]["statement"]
    assert (out / "fleet.html").is_file()


def test_estimators_without_intervals_are_refused_before_any_work(
    case: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    listed, text = case / "ridge.yaml", (case / "robots.yaml").read_text()
    for content, robot in (
        (text.replace("moments, effects: viscous_friction", "ridge"), "robot 1, 'arm0'"),
        (text.replace("arm4.npz}", "arm4.npz, options: {estimator: ridge}}"), "robot 5, 'arm4'"),
    ):
        listed.write_text(content)
        assert main(["fleet", str(listed), "-o", str(tmp_path / "out"), "-j", "1"]) == 2
        told = capsys.readouterr().err
        assert f"ridge.yaml: {robot}: estimator 'ridge' has no intervals, which a comparison" in told
        assert "take one of auto, physical, smoother, moments" in told
        assert not (tmp_path / "out").exists()


def test_the_earlier_time_is_another_folder(case: Path, capsys: pytest.CaptureFixture[str]) -> None:
    same = case / "out" / ".." / "out"
    assert main(["fleet", str(case / "robots.yaml"), "-o", str(case / "out"), "--before", str(same)]) == 2
    assert (
        "--before is the folder of -o, so that nothing could have changed; give the folder" in capsys.readouterr().err
    )


def test_only_another_format_makes_all_results_anew(case: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    files = [case / "out" / f"arm{k}" / "parameters.json" for k in range(ROBOTS)]
    command = ["fleet", str(case / "robots.yaml"), "-o", str(case / "out"), "-j", "1"]
    assert main(command) == 0
    before = [file.stat().st_mtime_ns for file in files]
    monkeypatch.setattr(fleet, "__version__", "9.9.dev1", raising=False)
    assert main(command) == 0
    assert [file.stat().st_mtime_ns for file in files] == before
    monkeypatch.setattr(fleet, "FORMAT", fleet.FORMAT + 1)
    assert main(command) == 0
    assert all(file.stat().st_mtime_ns != then for file, then in zip(files, before, strict=True))


@pytest.mark.parametrize("kind", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_keeps_what_is_done_and_the_next_call_goes_on(
    kind: signal.Signals,
    case: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    """It comes in the third robot, whose search is ended early, so that it is identified again."""
    usual, calls = fleet.identify, []

    def interrupted(urdf, recordings, **options):
        calls.append(recordings)
        if len(calls) == 3:
            os.kill(os.getpid(), kind)
        found = usual(urdf, recordings, **options)
        return dataclasses.replace(found, finished=False) if len(calls) == 3 else found

    monkeypatch.setattr(fleet, "identify", interrupted)
    listed, out = case / "robots.yaml", tmp_path / "out"
    assert main(["fleet", str(listed), "-o", str(out), "-j", "1"]) == 0
    told = capfd.readouterr()
    assert len(calls) == 3
    assert "finishing with what was found" in told.err
    content = json.loads((out / "fleet.json").read_text())
    assert content["finished"] is False
    assert [one["verdict"] for one in content["members"]] == ["identified"] * 2 + ["unfinished"] * (ROBOTS - 2)
    for words in (content["statement"], " ".join(told.out.split()), (out / "fleet.html").read_text()):
        assert f"Unfinished: {ROBOTS - 2} of {ROBOTS} robots are not identified yet; the same call goes on." in words
    assert (out / "arm2" / "parameters.json").is_file()
    assert main(["fleet", str(listed), "-o", str(out), "-j", "1"]) == 0
    assert len(calls) == 3 + ROBOTS - 2
    content = json.loads((out / "fleet.json").read_text())
    assert content["finished"] is True
    assert "nfinished" not in content["statement"]
