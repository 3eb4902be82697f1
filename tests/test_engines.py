"""Engines do every task, try again what died, and leave what input lacks as it is."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from functools import partial
from pathlib import Path

import pytest

from torchrbd import InputError, OptionError
from torchrbd._runtime import deadline
from torchrbd._runtime.engines import Engine


def square(x: int) -> int:
    if x == 3:
        raise InputError("three cannot be used")
    return x * x


def fails_at_first(folder: Path, x: int) -> int:
    """Fail once for each x, in a way nobody foresaw."""
    mark = folder / str(x)
    if not mark.exists():
        mark.touch()
        raise ZeroDivisionError("once")
    return x


def dies_at_first(folder: Path, parent: int, x: int) -> int:
    """Kill the process of task 2 once, if it is not the caller's own."""
    mark = folder / "died"
    if x == 2 and not mark.exists() and os.getpid() != parent:
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return x


def test_local_processes_do_all_in_order() -> None:
    told = []
    found = Engine(jobs=2).done(square, range(6), told.append)
    assert [one.value for one in found] == [0, 1, 4, None, 16, 25]
    assert str(found[3].error) == "three cannot be used"
    assert len(told) == 6


def test_what_is_not_begun_is_not_tried_again() -> None:
    told = []
    with deadline.asked():
        deadline.finish_soon()
        found = Engine(retries=2).done(square, range(4), told.append)
    assert [type(one.error).__name__ for one in found] == ["UnfinishedError"] * 4
    assert len(told) == 4


@pytest.mark.parametrize(("retries", "value"), [(0, None), (1, 7)])
def test_what_fails_unforeseen_is_tried_again(tmp_path: Path, retries: int, value: int | None) -> None:
    told = []
    (found,) = Engine(retries=retries).done(partial(fails_at_first, tmp_path), [7], told.append)
    assert found.value == value
    assert told == [found]


def test_what_does_not_fit_is_refused() -> None:
    with pytest.raises(OptionError, match="retries is -1; expected a whole number"):
        Engine(retries=-1)
    with pytest.raises(OptionError, match="a scheduler is for the engine dask"):
        Engine(scheduler="tcp://here:1")


def elsewhere(code: str) -> None:
    """Run code in another Python: importing Dask changes how exceptions are pickled."""
    pytest.importorskip("distributed")
    head = "import os, sys\nfrom functools import partial\nfrom pathlib import Path\nfrom test_engines import *\n"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(Path(__file__).parent), *sys.path])}
    subprocess.run([sys.executable, "-c", head + code], check=True, timeout=120, env=environment)


@pytest.mark.slow
def test_dask_does_all_and_survives_the_death_of_a_worker(tmp_path: Path) -> None:
    elsewhere(f"""
folder, engine = Path({str(tmp_path)!r}), Engine("dask", jobs=2)
found = engine.done(square, range(6))
assert [one.value for one in found] == [0, 1, 4, None, 16, 25]
assert str(found[3].error) == "three cannot be used"
found = engine.done(partial(dies_at_first, folder, os.getpid()), range(6))
assert (folder / "died").exists()
assert [one.value for one in found] == list(range(6))
""")


@pytest.mark.slow
def test_dask_leaves_the_rest_where_an_early_end_is_asked_for() -> None:
    elsewhere("""
told = []
def stop(one):
    told.append(one)
    deadline.finish_soon()
found = Engine("dask", jobs=1).done(square, [2, 4, 5, 6], stop)
done = [one.value for one in found if one.error is None]
assert len(done) == 1 and len(told) == 4
assert {type(one.error).__name__ for one in found if one.error} == {"UnfinishedError"}
""")


@pytest.mark.slow
def test_a_scheduler_that_is_not_there_is_told() -> None:
    elsewhere("""
try:
    Engine("dask", scheduler="tcp://127.0.0.1:9").done(square, [1])
except OptionError as error:
    assert str(error).startswith("scheduler 'tcp://127.0.0.1:9': ")
    assert "start 'dask scheduler'" in str(error)
else:
    raise AssertionError
""")
