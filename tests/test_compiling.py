"""C code as a library: built once, by whatever compiler there is, or done without."""

from __future__ import annotations

import logging
import shlex
import stat
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
import torch
from robot.random_robots import random_urdf

from torchrbd._runtime import compiling, filters
from torchrbd.effects.backlash import COMPILED
from torchrbd.robot import RobotModel, compiled
from torchrbd.robot.compiled import switch
from torchrbd.robot.compiled.calls import KERNELS

COMPILER = compiling._compiler()
needs_compiler = pytest.mark.skipif(COMPILER is None, reason="no C compiler")


@pytest.fixture
def counted(tmp_path: Path) -> tuple[list[str], Path]:
    """Return a compiler that notes in a file how often it was called."""
    assert COMPILER is not None
    script, calls = tmp_path / "counted", tmp_path / "calls"
    script.write_text(f'#!/bin/sh\necho once >> {shlex.quote(str(calls))}\nexec {shlex.join(COMPILER)} "$@"\n')
    script.chmod(script.stat().st_mode | stat.S_IXUSR)
    return [str(script)], calls


@needs_compiler
def test_built_once_and_nothing_left_beside(counted: tuple[list[str], Path], tmp_path: Path) -> None:
    compiler, calls = counted
    folder = tmp_path / "cache"
    with ThreadPoolExecutor(2) as pool:
        made = set(pool.map(lambda _: compiling.build(compiler, KERNELS, folder), range(2)))
    built = len(calls.read_text().splitlines())
    assert 1 <= built <= 2
    assert made == {compiling.build(compiler, KERNELS, folder)} == set(folder.iterdir())
    assert len(calls.read_text().splitlines()) == built


@needs_compiler
def test_another_compiler_or_machine_is_another_library(
    counted: tuple[list[str], Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # A compiler that makes anything is enough to see names.
    stub = tmp_path / "stub"
    stub.write_text('#!/bin/sh\nwhile [ "$1" != "-o" ]; do shift; done\n: > "$2"\n')
    stub.chmod(0o755)
    names = [compiling.build([str(stub), *options], KERNELS, tmp_path).name for options in ((), ("-g",))]
    monkeypatch.setattr(compiling, "_machine", lambda: "another")
    names.append(compiling.build([str(stub)], KERNELS, tmp_path).name)
    assert len(set(names)) == 3


@pytest.mark.parametrize(
    ("settings", "told"),
    [
        ({"TORCHRBD_KERNELS": "0"}, "TORCHRBD_KERNELS is 0"),
        ({"CC": "no-such-compiler"}, "found no C compiler; set CC"),
        ({"CC": f"{sys.executable} -c raise\\ SystemExit('broken')"}, "broken"),
    ],
)
def test_done_without(
    settings: dict[str, str],
    told: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    monkeypatch.setenv("TORCHRBD_CACHE", str(tmp_path))
    for name, value in settings.items():
        monkeypatch.setenv(name, value)
    with caplog.at_level(logging.DEBUG, "torchrbd"):
        assert compiling.library.__wrapped__(KERNELS) is None
    assert told in caplog.text
    assert not any(tmp_path.iterdir())


@needs_compiler
def test_a_cache_that_cannot_be_written_to(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Kernels are there for this process; nothing stays."""
    (tmp_path / "file").touch()
    monkeypatch.setenv("TORCHRBD_CACHE", str(tmp_path / "file"))
    with caplog.at_level(logging.DEBUG, "torchrbd"):
        assert compiling.library.__wrapped__(KERNELS) is not None
    assert "not kept, set TORCHRBD_CACHE" in caplog.text
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_a_robot_without_kernels(monkeypatch: pytest.MonkeyPatch) -> None:
    """Is computed by torch."""
    robot = RobotModel.from_urdf(random_urdf(3, 4))
    q = torch.linspace(-1, 1, 4, dtype=torch.float64)
    with compiled.only_eager():
        expected = [robot.inverse_dynamics(q, q, q), robot.regressor(q, q, q), robot.mass_matrix(q)]
    monkeypatch.setattr(switch, "library", lambda source: None)
    assert not compiled.is_available()
    found = [robot.inverse_dynamics(q, q, q), robot.regressor(q, q, q), robot.mass_matrix(q)]
    assert all(map(torch.equal, found, expected))
    robot.torque_slopes(q, q, q)


def test_cache_folder_of_the_platform(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    assert str(compiling.cache_folder()) == compiling.os.environ["TORCHRBD_CACHE"]
    monkeypatch.delenv("TORCHRBD_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(compiling.sys, "platform", "linux")
    assert compiling.cache_folder() == tmp_path / "torchrbd"
    monkeypatch.setattr(compiling.sys, "platform", "darwin")
    assert compiling.cache_folder().parts[-3:] == ("Library", "Caches", "torchrbd")


@pytest.mark.parametrize("source", [KERNELS, COMPILED, filters.COMPILED], ids=lambda source: source.files[0])
def test_sources_are_all_there(source: compiling.Source) -> None:
    """What a library's name is made of is what it is built of."""
    assert set(source.files) == {path.name for path in source.folder.iterdir() if path.suffix in (".c", ".h")}
