"""Parallel work on many tasks: this process and helper processes, without waiting until those have started.

Helpers are new Python processes that communicate through pipes. They are not forked, since torch may hold threads and
devices. They do not run the caller's script again, so it needs no ``if __name__ == "__main__"``.
"""

from __future__ import annotations

import os
import pickle
import signal
import subprocess
import sys
import time
import warnings
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from queue import SimpleQueue
from threading import Thread
from typing import IO, Any, Generic, TypeVar

from torchrbd._runtime.deadline import finish_soon, on_request
from torchrbd.errors import OptionError, UnfinishedError

Task = TypeVar("Task")
Value = TypeVar("Value")

_HELPER = "import sys; sys.path[:] = sys.argv[1:]; from torchrbd._runtime.processes import help_parent; help_parent()"


@dataclass(frozen=True)
class Attempt(Generic[Value]):
    """The result of one task.

    Attributes:
        value: the work's return value, None if it failed.
        error: its exception, without a traceback; None if it succeeded.
        seconds: time that it took.
    """

    value: Value | None
    error: Exception | None
    seconds: float


def side_by_side(
    work: Callable[[Task], Value],
    tasks: Sequence[Task],
    *,
    jobs: int | None = None,
    on_result: Callable[[Attempt[Value]], None] = lambda _: None,
) -> list[Attempt[Value]]:
    """Do the work on each task; an error in one does not stop the others.

    If the user asks for an early end (``deadline.py``), helpers are asked, too, and no other task is begun: the attempt
    at it has an UnfinishedError.

    A helper takes a task when it has started, which takes as long as the imports of ``work``; this process works from
    the beginning. Tasks and values that cannot be pickled are processed here. So is everything, with a warning, if
    ``work`` cannot be pickled.

    Args:
        work: done on one task.
        tasks: any number of them; a single one uses no helpers.
        jobs: number of processes. Default: one for each core that this process may use.
        on_result: called with each attempt, in this thread, between the tasks that are processed here.

    Returns:
        attempts in the order of the tasks.

    Raises:
        OptionError: ``jobs`` is not a whole number above 0.
        Exception: what ``on_result`` raises, and KeyboardInterrupt; helpers are then ended.
    """
    waiting, done = deque(enumerate(tasks)), SimpleQueue[tuple[int, Attempt[Value] | None]]()
    found: dict[int, Attempt[Value]] = {}
    problems: list[str] = []
    with _helpers(work, min(_processes(jobs), len(tasks)) - 1, waiting, done, problems):
        while len(found) < len(tasks):
            k, attempt = _next(waiting, done)
            found[k] = attempted(work, tasks[k]) if attempt is None else attempt
            on_result(found[k])
    if problems:
        warnings.warn(f"all was done in one process; helpers cannot be used: {problems[0]}", stacklevel=2)
    return [found[k] for k in range(len(tasks))]


def help_parent() -> None:
    """Work for the parent process as long as it asks: the main function of a helper.

    The first message is the work; its answer is an error message, empty if there is none. The other messages are tasks;
    their answers are attempts, empty if they cannot be pickled.
    """
    signal.signal(signal.SIGTERM, lambda *_: finish_soon())
    asked, answers = sys.stdin.buffer, os.fdopen(os.dup(1), "wb")
    # Printed text would mix with the answers.
    os.dup2(2, 1)
    with suppress(EOFError, BrokenPipeError):
        message, problem, work = _receive(asked), "", None
        try:
            work = pickle.loads(message)
        except Exception as error:
            problem = _words(error)
        _send(answers, problem.encode())
        while work is not None:
            message = _receive(asked)
            try:
                answer = pickle.dumps(attempted(work, pickle.loads(message)))
            except Exception:
                answer = b""
            _send(answers, answer)


def cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _processes(jobs: int | None) -> int:
    if jobs is None:
        return cores()
    if isinstance(jobs, bool) or not isinstance(jobs, int) or jobs < 1:
        raise OptionError(f"jobs is {jobs!r}; expected a whole number of processes above 0")
    return jobs


def _next(waiting: deque[Any], done: SimpleQueue[Any]) -> tuple[int, Attempt[Any] | None]:
    """Return a result of the helpers, else a task to do here, else wait for a result."""
    if done.empty():
        with suppress(IndexError):
            return waiting.popleft()[0], None
    return done.get()


@contextmanager
def _helpers(
    work: Callable[..., Any], count: int, waiting: deque[Any], done: SimpleQueue[Any], problems: list[str]
) -> Iterator[None]:
    """Start helpers, each with a thread that hands it waiting tasks; end them all afterwards."""
    message = b""
    # The executable of a frozen program is the program itself, not Python.
    if count < 1 or getattr(sys, "frozen", False):
        count = 0
    else:
        try:
            message = pickle.dumps(work)
        except Exception as error:
            problems.append(_words(error))
            count = 0
    processes: list[subprocess.Popen[bytes]] = []
    threads: list[Thread] = []

    def end_soon() -> None:
        _leave_waiting(waiting, done)
        for process in processes:
            process.terminate()

    try:
        with on_request(end_soon):
            for _ in range(count):
                processes.append(_start())
                given = processes[-1], message, waiting, done, problems
                threads.append(Thread(target=_hand_over, args=given, daemon=True))
                threads[-1].start()
            yield
    finally:
        for process in processes:
            process.kill()
        for thread in threads:
            thread.join()
        for process in processes:
            process.communicate()


def _leave_waiting(waiting: deque[Any], done: SimpleQueue[Any]) -> None:
    """Leave the waiting tasks undone; a signal handler may call it, as neither queue has a lock that it could hold."""
    with suppress(IndexError):
        while True:
            k, _ = waiting.popleft()
            error = UnfinishedError("was not begun: you asked for an early end; do it again")
            done.put((k, Attempt(None, error, 0.0)))


def _start() -> subprocess.Popen[bytes]:
    """Start a helper with the same module path; only this process handles Ctrl-C, and sends SIGTERM to helpers."""
    return subprocess.Popen(
        [sys.executable, "-c", _HELPER, *sys.path],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        start_new_session=True,
        creationflags=getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0),
    )


def _hand_over(
    process: subprocess.Popen[bytes], work: bytes, waiting: deque[Any], done: SimpleQueue[Any], problems: list[str]
) -> None:
    """Give a helper one task after another as long as there are tasks and it is alive."""
    asked, answers = process.stdin, process.stdout
    assert asked is not None
    assert answers is not None
    try:
        _send(asked, work)
        problem = _receive(answers).decode()
    except (EOFError, OSError):
        return
    if problem:
        problems.append(problem)
        return
    with suppress(IndexError):
        while process.poll() is None:
            k, task = waiting.popleft()
            done.put((k, _asked(process, asked, answers, task)))


def _asked(process: subprocess.Popen[bytes], asked: IO[bytes], answers: IO[bytes], task: Any) -> Attempt[Any] | None:
    """Return a helper's attempt at a task; None if it cannot be pickled."""
    start = time.perf_counter()
    try:
        _send(asked, pickle.dumps(task))
        answer = _receive(answers)
        return pickle.loads(answer) if answer else None
    except (EOFError, OSError):
        words = f"its process ended with code {process.wait()}; where memory is short, use fewer jobs"
        return Attempt(None, RuntimeError(words), time.perf_counter() - start)
    except Exception:
        return None


def _send(pipe: IO[bytes], message: bytes) -> None:
    # A bytes object in a pickle is read as a whole, for any content.
    pickle.dump(message, pipe)
    pipe.flush()


def _receive(pipe: IO[bytes]) -> bytes:
    return pickle.load(pipe)


def attempted(work: Callable[[Task], Value], task: Task) -> Attempt[Value]:
    """Do the work on one task, and return the attempt; an error is part of it."""
    start, value, error = time.perf_counter(), None, None
    try:
        value = work(task)
    except Exception as raised:
        error = _portable(raised)
    return Attempt(value, error, time.perf_counter() - start)


def _portable(error: Exception) -> Exception:
    """Return an error as another process would send it: without traceback, which refers to large objects."""
    try:
        return pickle.loads(pickle.dumps(error))
    except Exception:
        return RuntimeError(_words(error))


def _words(error: Exception) -> str:
    return f"{type(error).__name__}: {error}"
