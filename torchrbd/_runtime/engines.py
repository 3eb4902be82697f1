"""Work on many independent tasks by an engine: the processes of this machine, or a Dask cluster.

Dask was chosen over Ray, both of which retry and survive the death of a worker: it takes 44 MB of disk against 259, and
a cluster is two commands (``dask scheduler``, ``dask worker``) on machines that see the same files.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Generic, Literal, TypeVar

from torchrbd._runtime.deadline import asked_for
from torchrbd._runtime.processes import Attempt, attempted, cores, side_by_side
from torchrbd.errors import OptionError, TorchRBDError, UnfinishedError

Task = TypeVar("Task")
Value = TypeVar("Value")
Name = Literal["local", "dask"]

# How long a scheduler may take to answer [s].
_PATIENCE_S = 10


@dataclass(frozen=True)
class Engine:
    """Where work is done.

    Attributes:
        name: "local", processes of this machine; "dask", a cluster.
        jobs: processes on this machine; None for one a core. A cluster that is named has its own.
        scheduler: address of a Dask cluster; None for one of this machine's processes.
        retries: how often a task is tried again whose process has died, or that failed in a way nobody foresaw.
    """

    name: Name = "local"
    jobs: int | None = None
    scheduler: str | None = None
    retries: int = 2

    def __post_init__(self) -> None:
        if self.retries < 0:
            raise OptionError(f"retries is {self.retries}; expected a whole number that is not negative")
        if self.scheduler is not None and self.name != "dask":
            raise OptionError(f"a scheduler is for the engine dask, not for {self.name}; add --engine dask")

    def done(
        self,
        work: Callable[[Task], Value],
        tasks: Sequence[Task],
        on_result: Callable[[Attempt[Value]], None] = lambda _: None,
    ) -> list[Attempt[Value]]:
        """Do the work on each task; an error of one does not stop the others.

        If the user asks for an early end (``deadline.py``), no other task is begun: the attempt at it has an
        UnfinishedError. What a cluster is working on is left undone as well.

        Args:
            work: done on one task; it can be pickled, as can tasks and values.
            tasks: any number of them.
            on_result: called with each attempt that is the last of its task.

        Returns:
            the last attempts, in the order of the tasks.

        Raises:
            OptionError: the engine cannot be used.
        """
        if self.name == "dask":
            return _by_dask(self, work, tasks, on_result)
        return _by_processes(self, work, tasks, on_result)


def _by_processes(
    engine: Engine, work: Callable[[Task], Value], tasks: Sequence[Task], on_result: Callable[[Attempt[Value]], None]
) -> list[Attempt[Value]]:
    found: dict[int, Attempt[Value]] = {}
    left = list(range(len(tasks)))
    for round_number in range(engine.retries + 1):
        last = round_number == engine.retries

        def tell(one: Attempt[Value], last: bool = last) -> None:
            if last or not _again(one):
                on_result(one)

        attempts = side_by_side(work, [tasks[k] for k in left], jobs=engine.jobs, on_result=tell)
        found |= dict(zip(left, attempts, strict=True))
        left = [k for k in left if _again(found[k])]
        if not left:
            break
    return [found[k] for k in range(len(tasks))]


def _again(one: Attempt[Any]) -> bool:
    """Say whether another attempt may do better: what the input lacks it will lack then, too."""
    return one.error is not None and not isinstance(one.error, TorchRBDError | OSError)


@dataclass(frozen=True)
class _Attempted(Generic[Task, Value]):
    """Work whose errors are values, so that Dask tries again what died and nothing else."""

    work: Callable[[Task], Value]
    retries: int

    def __call__(self, task: Task) -> Attempt[Value]:
        found = attempted(self.work, task)
        for _ in range(self.retries if _again(found) else 0):
            found = attempted(self.work, task)
            if not _again(found):
                break
        return found


def _by_dask(
    engine: Engine, work: Callable[[Task], Value], tasks: Sequence[Task], on_result: Callable[[Attempt[Value]], None]
) -> list[Attempt[Value]]:
    with _client(engine) as client:
        from distributed import as_completed

        tried = _Attempted(work, engine.retries)
        futures = {client.submit(tried, task, pure=False): k for k, task in enumerate(tasks)}
        found: dict[int, Attempt[Value]] = {}
        for future in () if asked_for() else as_completed(futures):
            try:
                one: Attempt[Value] = future.result()
            except Exception as error:
                one = Attempt(None, RuntimeError(f"its worker died again and again ({error})"), 0.0)
            found[futures[future]] = one
            on_result(one)
            if asked_for():
                break
    for k in range(len(tasks)):
        if k not in found:
            error = UnfinishedError("was not ended: you asked for an early end; do it again")
            found[k] = Attempt(None, error, 0.0)
            on_result(found[k])
    return [found[k] for k in range(len(tasks))]


@contextmanager
def _client(engine: Engine) -> Iterator[Any]:
    """Connect to a cluster, or start one on this machine and end it."""
    try:
        from dask import config
        from distributed import Client, LocalCluster
    except ImportError:
        raise OptionError("the engine dask needs its package: pip install 'torchrbd[fleet]'") from None
    # As often as a worker may die under a task.
    with config.set({"distributed.scheduler.allowed-failures": engine.retries}):
        if engine.scheduler is not None:
            try:
                client = Client(engine.scheduler, timeout=_PATIENCE_S)
            except (OSError, ValueError) as error:
                raise OptionError(
                    f"scheduler '{engine.scheduler}': {error}; start 'dask scheduler', give the address that it prints"
                ) from None
            with client:
                yield client
            return
        count = cores() if engine.jobs is None else engine.jobs
        with (
            LocalCluster(
                n_workers=count,
                threads_per_worker=1,
                dashboard_address=None,  # type: ignore[arg-type]
                silence_logs=logging.CRITICAL,
            ) as cluster,
            Client(cluster) as client,
        ):
            yield client
