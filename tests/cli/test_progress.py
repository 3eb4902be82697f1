"""Work that takes long says on stderr what it does, a line a stage, on a terminal or not; --quiet keeps it silent."""

from __future__ import annotations

import io
import re
import time

import pytest
from rich.console import Console

from torchrbd.cli import main, progress
from torchrbd.cli.progress import progress_bar


@pytest.fixture(params=[False, True], ids=["pipe", "terminal"])
def stream(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> io.StringIO:
    """Where lines go; they may come ten times a second."""
    written = io.StringIO()
    monkeypatch.setattr(progress, "_EVERY_S", 0.1)
    monkeypatch.setattr(progress, "_STILL_S", 0.5)
    monkeypatch.setattr(progress, "Console", lambda **_: Console(file=written, force_terminal=request.param, width=100))
    return written


def lines(stream: io.StringIO) -> list[str]:
    """The lines that stay, without the bar's own."""
    plain = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", stream.getvalue()).replace("\r", "\n")
    return re.findall(r"^torchrbd: .*$", plain, re.MULTILINE)


def test_a_line_a_stage_with_the_time(stream: io.StringIO) -> None:
    with progress_bar() as told:
        for stage in ("one", "two", "two", "three"):
            told(stage, 0.0)
            time.sleep(0.25)
    found = [re.fullmatch(r"torchrbd: ([\d.]+) s, (\w+)", line) for line in lines(stream)]
    assert [one and one[2] for one in found] == ["one", "two", "three"]
    times = [float(one[1]) for one in found if one]
    assert times == sorted(times)
    assert times[-1] < 30.0


def test_a_long_stage_is_told_again_with_its_part(stream: io.StringIO) -> None:
    with progress_bar() as told:
        for part in (0.2, 0.6):
            told("long", part)
            time.sleep(0.8)
    found = lines(stream)
    assert re.search(r" s, long, 20 %$", found[0])
    assert re.search(r" s, long, 60 %$", found[-1])
    assert 2 <= len(found) <= 5


def test_what_is_done_at_once_says_nothing(stream: io.StringIO) -> None:
    with progress_bar() as told:
        told("brief", 0.0)
    assert lines(stream) == []


@pytest.mark.parametrize("options", [{"quiet": True}, {"shown": False}])
def test_silence(options: dict[str, bool], stream: io.StringIO) -> None:
    with progress_bar(**options) as told:
        told("long", 0.0)
        time.sleep(0.3)
    assert stream.getvalue() == ""


def test_stages_with_brackets_are_no_markup(stream: io.StringIO) -> None:
    with progress_bar() as told:
        told("reading [b]day[/b]", 0.0)
        time.sleep(0.3)
    assert "reading [b]day[/b]" in lines(stream)[0]


@pytest.mark.parametrize(
    "command", ["identify", "diagnose", "compare-estimators", "demo", "excite", "simulate", "stats", "fleet"]
)
def test_commands_that_take_long_can_be_quiet(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([command, "--help"]) == 0
    assert "--quiet" in capsys.readouterr().out
