"""Work side by side: as in a loop, in order, and no helper is left behind, however it ends."""

from __future__ import annotations

import math
import os
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path
from threading import get_ident

import pytest

from torchrbd._runtime import deadline
from torchrbd._runtime.processes import Attempt, side_by_side
from torchrbd.errors import OptionError, UnfinishedError

ROOT = Path(__file__).parent.parent
SHORT_S, LONG_S = 0.01, 30.0


def until(true, seconds: float = LONG_S) -> bool:
    """Wait until something is true, and say whether it has become so."""
    end = time.monotonic() + seconds
    while not true() and time.monotonic() < end:
        time.sleep(SHORT_S)
    return true()


def together(folder: Path, task: float, processes: int = 2) -> tuple[float, int]:
    """Return a square root and the process, once so many processes have been at work in a folder."""
    (folder / str(os.getpid())).touch()
    assert until(lambda: len(list(folder.iterdir())) >= processes)
    print("words of somebody's library")
    return math.sqrt(task), os.getpid()


def helpers_in(folder: Path) -> list[int]:
    return [int(path.name) for path in folder.iterdir() if path.name != str(os.getpid())]


def lives(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    return not Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].startswith(" Z")


class OddError(Exception):
    """An error that pickle cannot make again."""

    def __init__(self, first: str, second: str) -> None:
        super().__init__(first)
        self.second = second


def fails_with_odd(folder: Path, task: int) -> int:
    together(folder, task)
    if task == 4:
        raise OddError("odd", "words")
    return task


def ends_in_helper(parent: int, folder: Path, task: int) -> int:
    together(folder, task)
    if os.getpid() != parent:
        os._exit(3)
    return task


def hangs_in_helper(parent: int, folder: Path, task: int) -> None:
    together(folder, task)
    if os.getpid() != parent:
        time.sleep(LONG_S)


def function_in_helper(parent: int, folder: Path, task: int):
    together(folder, task)
    return task if os.getpid() == parent else (lambda: task)


def test_both_work_and_results_are_in_order(tmp_path: Path) -> None:
    seen: list[tuple[Attempt, int]] = []
    work = partial(together, tmp_path)
    tasks = [float(k) for k in range(20)]
    found = side_by_side(work, tasks, jobs=2, on_result=lambda one: seen.append((one, get_ident())))
    assert [one.value[0] for one in found if one.value] == [math.sqrt(task) for task in tasks]
    assert {one.value[1] for one in found if one.value} == {os.getpid(), *helpers_in(tmp_path)}
    assert len(helpers_in(tmp_path)) == 1
    assert sorted(id(one) for one, _ in seen) == sorted(map(id, found))
    assert {thread for _, thread in seen} == {get_ident()}
    assert not any(map(lives, helpers_in(tmp_path)))


@pytest.mark.parametrize(("jobs", "tasks"), [(1, [4.0, 9.0]), (3, [4.0]), (3, [])])
def test_one_task_or_one_job_needs_no_helper(jobs: int, tasks: list[float], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(subprocess, "Popen")
    assert [one.value for one in side_by_side(math.sqrt, tasks, jobs=jobs)] == [math.sqrt(task) for task in tasks]


def test_there_is_a_process_a_core_that_may_be_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1, 2}, raising=False)
    side_by_side(partial(together, tmp_path, processes=3), [1.0] * 9)
    assert len(helpers_in(tmp_path)) == 2


def test_an_error_is_that_of_its_task_alone(tmp_path: Path) -> None:
    """With negative numbers everywhere, both processes meet some."""
    work = partial(together, tmp_path)
    found = side_by_side(work, [4.0, -1.0] * 10, jobs=2)
    assert [one.value[0] if one.value else None for one in found] == [2.0, None] * 10
    assert {str(one.error) for one in found[1::2]} == {"math domain error"}
    assert {type(one.error) for one in found} == {ValueError, type(None)}
    assert all(one.error is None or one.error.__traceback__ is None for one in found)


def test_an_error_that_cannot_be_pickled_is_told_in_words(tmp_path: Path) -> None:
    found = side_by_side(partial(fails_with_odd, tmp_path), [4, 4, 9], jobs=2)
    assert [(type(one.error), str(one.error)) for one in found[:2]] == [(RuntimeError, "OddError: odd")] * 2
    assert found[2].value == 9


def test_a_helper_that_dies_costs_its_task_alone(tmp_path: Path) -> None:
    found = side_by_side(partial(ends_in_helper, os.getpid(), tmp_path), [0, 1, 2, 3], jobs=2)
    (lost,) = (one.error for one in found if one.error)
    assert isinstance(lost, RuntimeError)
    assert "its process ended with code 3; where memory is short, use fewer jobs" in str(lost)
    assert sum(one.value == k for k, one in enumerate(found)) == 3


def test_what_cannot_be_pickled_is_done_here(tmp_path: Path) -> None:
    found = side_by_side(partial(function_in_helper, os.getpid(), tmp_path), [1, 2, 3, 4], jobs=2)
    assert [one.value for one in found] == [1, 2, 3, 4]
    tasks = [lambda k=k: k for k in range(4)]
    (tmp_path / "own").mkdir()
    found = side_by_side(partial(called_with_own_pid, tmp_path / "own"), tasks, jobs=2)
    assert [one.value for one in found] == [(k, os.getpid()) for k in range(4)]


def called_with_own_pid(folder: Path, task) -> tuple[int, int]:
    time.sleep(10 * SHORT_S)
    return task(), os.getpid()


def test_work_that_cannot_be_pickled_is_done_here_with_a_warning() -> None:
    with pytest.warns(UserWarning, match=r"all was done in one process; .*pickle"):
        found = side_by_side(lambda task: task + 1, [1, 2], jobs=2)
    assert [one.value for one in found] == [2, 3]


@pytest.mark.parametrize("jobs", [0, -1, 1.5, True, "2"])
def test_jobs_are_a_number_above_zero(jobs: object) -> None:
    with pytest.raises(OptionError, match="expected a whole number of processes above 0"):
        side_by_side(math.sqrt, [1.0], jobs=jobs)  # type: ignore[arg-type]


@pytest.mark.parametrize("error", [KeyboardInterrupt, ValueError])
def test_what_is_raised_while_told_ends_all(error: type[BaseException], tmp_path: Path) -> None:
    def stop(_: Attempt) -> None:
        raise error

    start = time.monotonic()
    with pytest.raises(error):
        side_by_side(partial(hangs_in_helper, os.getpid(), tmp_path), [1, 2, 3], jobs=2, on_result=stop)
    assert time.monotonic() - start < LONG_S / 2
    (helper,) = helpers_in(tmp_path)
    assert not lives(helper)


def ends_when_asked(parent: int, folder: Path, task: int) -> tuple[int, int]:
    """Ask for an end here, once a helper is at work, and return what has ended early."""
    together(folder, task)
    if os.getpid() == parent:
        deadline.finish_soon()
    assert until(deadline.asked_for)
    return task, os.getpid()


@pytest.mark.parametrize("jobs", [1, 2])
def test_work_that_is_asked_to_end_keeps_what_is_begun_and_begins_no_more(jobs: int, tmp_path: Path) -> None:
    told: list[Attempt] = []
    work = partial(ends_when_asked, os.getpid(), tmp_path) if jobs == 2 else asks_for_an_end
    with deadline.asked():
        found = side_by_side(work, list(range(8)), jobs=jobs, on_result=told.append)
        assert len(told) == 8
        (unbegun,) = side_by_side(math.sqrt, [4.0], jobs=jobs)
    done = [one.value for one in found if one.value is not None]
    assert len(done) == jobs
    assert {process for _, process in done} == {os.getpid(), *(helpers_in(tmp_path) if jobs == 2 else ())}
    assert {type(one.error) for one in (*found, unbegun) if one.value is None} == {UnfinishedError}
    assert str(unbegun.error) == "was not begun: you asked for an early end; do it again"
    assert [one.value for one in side_by_side(math.sqrt, [4.0], jobs=jobs)] == [2.0]


def asks_for_an_end(task: int) -> tuple[int, int]:
    deadline.finish_soon()
    return task, os.getpid()


SCRIPT = """
import signal, sys
# What a shell starts in the background ignores Ctrl-C.
signal.signal(signal.SIGINT, signal.default_int_handler)
from functools import partial
from pathlib import Path
from test_processes import together
from torchrbd._runtime.processes import side_by_side
with open(sys.argv[2], "a") as file:
    file.write("script ")
found = side_by_side(partial(together, Path(sys.argv[1])), [4.0] * {tasks}, jobs=2)
assert {{one.value[0] for one in found}} == {{2.0}}
assert len({{one.value[1] for one in found}}) == 2
"""


def script(folder: Path, tasks: int) -> subprocess.Popen[str]:
    """Start a script that does not look whether it is the main one."""
    (folder / "met").mkdir()
    (folder / "script.py").write_text(SCRIPT.format(tasks=tasks))
    paths = os.pathsep.join((str(ROOT), str(ROOT / "tests")))
    command = [sys.executable, str(folder / "script.py"), str(folder / "met"), str(folder / "runs")]
    environment = os.environ | {"PYTHONPATH": paths}
    return subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True)


def test_a_script_is_run_once(tmp_path: Path) -> None:
    process = script(tmp_path, tasks=4)
    told = process.communicate()[1]
    assert process.returncode == 0, told
    assert (tmp_path / "runs").read_text() == "script "


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks for processes in /proc")
@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGKILL])
def test_no_helper_outlives_its_parent(how: signal.Signals, tmp_path: Path) -> None:
    process = script(tmp_path, tasks=10**6)
    met = tmp_path / "met"
    assert until(lambda: met.exists() and len(list(met.iterdir())) == 2)
    (helper,) = (int(path.name) for path in met.iterdir() if path.name != str(process.pid))
    # A terminal sends Ctrl-C to all in a session.
    assert os.getsid(helper) == helper
    process.send_signal(how)
    told = process.communicate()[1]
    assert process.returncode == -how
    # One interrupt is told of, that of the parent, wherever it was: while handling another exception, too.
    assert told.count("Traceback") - told.count("During handling of") == (how == signal.SIGINT)
    assert told.count("\nKeyboardInterrupt") == (how == signal.SIGINT)
    assert until(lambda: not lives(helper))
