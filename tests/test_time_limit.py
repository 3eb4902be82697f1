"""A run that is stopped leaves the best model so far, marked as unfinished: at a time limit, or when a user asks."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from inference.problems import urdf_of
from shortened import slow_but
from simulated import Motion, joint_names, record

import torchrbd
from torchrbd._runtime import deadline
from torchrbd.cli import main

URDF = urdf_of(2, 2)
NAMES = joint_names(URDF)


def friction(motion: Motion) -> np.ndarray:
    return motion.qd * [0.4, 0.2] + 0.8 * np.sign(motion.qd) + [0.0, 3.0] * np.sin(4.0 * motion.q)


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with arm.urdf and day.npz, of an arm with a torque ripple that its URDF lacks."""
    folder = tmp_path_factory.mktemp("case")
    (folder / "arm.urdf").write_text(URDF)
    (chunk,) = record(URDF, 3, extra=friction, duration_s=15.0).chunks(10**6)
    np.savez(folder / "day.npz", t=chunk.t, q=chunk.q, tau=chunk.tau, joints=np.array(NAMES))
    return folder


@pytest.mark.parametrize(
    ("given", "seconds"),
    [(None, None), (60, 60.0), (0.5, 0.5), ("90", 90.0), ("90s", 90.0), ("2min", 120.0), ("1 h", 3600.0)],
)
def test_limits_that_are_understood(given: object, seconds: float | None) -> None:
    assert torchrbd.Settings.from_mapping({"time_limit": given}, "run.yaml").time_limit == seconds


@pytest.mark.parametrize("given", [0, -1, "soon", "5 parsecs", float("nan"), True, "1min30s", [3]])
def test_limits_that_are_not(given: Any, case: Path) -> None:
    for call in (torchrbd.identify, torchrbd.diagnose):
        with pytest.raises(torchrbd.OptionError, match=r"time_limit.*expected seconds.*'90s'"):
            call(case / "arm.urdf", case / "day.npz", time_limit=given)


def test_nothing_is_limited_by_itself() -> None:
    assert not deadline.is_over()
    with deadline.limited(1e-9):
        time.sleep(1e-3)
        assert deadline.is_over()
        with deadline.limited(None):
            assert not deadline.is_over()
            assert not deadline.stopped()
        assert deadline.stopped()
    assert not deadline.is_over()
    assert not deadline.stopped()


@pytest.mark.usefixtures("fit_alone", "without_joint_figures")
def test_a_limit_that_is_not_reached_changes_nothing(case: Path) -> None:
    found = torchrbd.identify(case / "arm.urdf", case / "day.npz", time_limit="1h")
    same = torchrbd.identify(case / "arm.urdf", case / "day.npz")
    assert found.finished
    assert found.notes == same.notes
    assert [p.value for p in found.parameters] == [p.value for p in same.parameters]


@pytest.mark.usefixtures("fit_alone", "without_joint_figures")
@pytest.mark.parametrize("command", ["identify", "diagnose"])
def test_a_tiny_limit_leaves_marked_results(
    command: str, case: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    effects = ["--effects", "stribeck_friction"] if command == "identify" else []
    given = [str(case / "arm.urdf"), str(case / "day.npz"), "-o", str(tmp_path), *effects, "--time-limit", "0.01s"]
    assert main([command, *given]) == 0
    told = " ".join(capsys.readouterr().out.split())
    assert "(unfinished): " in told
    assert "the search ended at the time limit of 0.01 s" in told
    for name in ("parameters.json", *(["diagnosis.json"] if command == "diagnose" else [])):
        content = json.loads((tmp_path / name).read_text())
        assert content["finished"] is False
        assert any("unfinished: the search ended at the time limit of 0.01 s" in note for note in content["notes"])
    assert "(unfinished)" in (tmp_path / "report.html").read_text()
    model = torchrbd.load_model(tmp_path / "model.safetensors")
    assert model.robot.joint_names == tuple(NAMES)
    if command == "diagnose":
        assert "Unfinished: the search was ended early" in content["statement"]
        # Curves are learnt with the noise, which no limit cuts short.
        assert all(one["effect"].startswith("smooth_") for one in content["ranking"]["adopted"])


@pytest.mark.usefixtures("fit_alone", "without_joint_figures")
@pytest.mark.parametrize("kind", slow_but((signal.SIGINT,), (signal.SIGINT, signal.SIGTERM)))
def test_the_first_interrupt_finishes_with_what_was_found(
    kind: signal.Signals,
    case: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    """It comes where the first term has been added: that is fitted and reported."""
    ranking, before = import_module("torchrbd.diagnosis.ranking"), signal.getsignal(kind)
    search_effects = ranking.search_effects

    def stops_after_one(base: Any, effects: Any, report: Callable[[float, int], None]) -> Any:
        def stop(part: float, terms: int) -> None:
            report(part, terms)
            os.kill(os.getpid(), kind)

        return search_effects(base, effects, stop)

    monkeypatch.setattr(ranking, "search_effects", stops_after_one)
    assert main(["diagnose", str(case / "arm.urdf"), str(case / "day.npz"), "-o", str(tmp_path)]) == 0
    told = capfd.readouterr()
    assert "finishing with what was found; press Ctrl-C again to stop at once" in told.err
    assert "(unfinished): " in told.out
    content = json.loads((tmp_path / "diagnosis.json").read_text())
    assert content["finished"] is False
    assert "Unfinished: the search was ended early" in content["statement"]
    assert any("because you asked for it" in note for note in content["notes"])
    assert len(content["ranking"]["adopted"]) == 1
    fits = {name: np.mean(list(fit["nmse"].values())) for name, fit in content["fit"].items()}
    assert fits["extended"] < 0.5 * fits["rigid_body"]
    assert signal.getsignal(kind) is before
    with deadline.limited(None):
        assert not deadline.is_over()


@pytest.fixture
def running(case: Path, tmp_path: Path) -> Iterator[subprocess.Popen[str]]:
    """A diagnosis of the demo that is on its way."""
    command = [sys.executable, "-u", "-m", "torchrbd", "demo", "-o", str(tmp_path / "out")]
    run = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env={**os.environ})
    assert run.stderr is not None
    for line in run.stderr:
        if "looking for" in line:
            break
    yield run
    run.kill()
    run.communicate()


@pytest.mark.parametrize("kind", slow_but((signal.SIGINT,), (signal.SIGINT, signal.SIGTERM)))
def test_the_second_interrupt_stops_at_once(
    kind: signal.Signals, running: subprocess.Popen[str], tmp_path: Path
) -> None:
    running.send_signal(kind)
    assert running.stderr is not None
    for line in running.stderr:
        if "finishing" in line:
            break
    running.send_signal(kind)
    _, errors = running.communicate()
    assert running.returncode == 130
    assert "Traceback" not in errors
    assert not (tmp_path / "out").exists()
