"""Time an identification of the demo case on one thread and on a thread a core, with busy cores and without.

    python benchmarks/threads.py

The two take turns, so that a machine whose speed varies is as fast for both. Each runs in a process of its own, since
libraries start their threads once; what it imports and its first run do not count. Cores are kept busy by one process
each that computes without end.
"""

from __future__ import annotations

import argparse
import multiprocessing as mp
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.resources import files
from multiprocessing.connection import Connection
from statistics import median

from rich.console import Console
from rich.table import Table

POLICIES = {"one thread": True, "a thread a core": False}


def spin() -> None:
    """Compute without end."""
    while True:
        pass


@contextmanager
def busy(cores: int) -> Iterator[None]:
    """Keep some cores busy."""
    others = [mp.Process(target=spin, daemon=True) for _ in range(cores)]
    for other in others:
        other.start()
    try:
        yield
    finally:
        for other in others:
            other.kill()
            other.join()


def serve(asked: Connection, single: bool) -> None:
    """Answer every request with the seconds of an identification."""
    import torchrbd

    identify = torchrbd.identify if single else torchrbd.identify.__wrapped__
    case = files("torchrbd") / "demo"
    identify(case / "arm.urdf", case / "fit.parquet", holdout=case / "holdout.parquet")
    asked.send(0.0)
    while asked.recv():
        start = time.perf_counter()
        identify(case / "arm.urdf", case / "fit.parquet", holdout=case / "holdout.parquet")
        asked.send(time.perf_counter() - start)


def timed(repeats: int) -> dict[str, list[float]]:
    """Return the seconds of each policy, in turns."""
    seconds: dict[str, list[float]] = {name: [] for name in POLICIES}
    pipes = {}
    for name, single in POLICIES.items():
        pipes[name], far = mp.Pipe()
        mp.Process(target=serve, args=(far, single), daemon=True).start()
        pipes[name].recv()
    for _ in range(repeats):
        for name, pipe in pipes.items():
            pipe.send(True)
            seconds[name].append(pipe.recv())
    for pipe in pipes.values():
        pipe.send(False)
    return seconds


def main() -> None:
    """Print medians, ranges and ratios."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--repeats", type=int, default=5, metavar="N", help="(default: %(default)s)")
    repeats = options.parse_args().repeats
    cores = os.cpu_count() or 1
    mp.set_start_method("spawn")
    table = Table(f"{cores} cores", *(f"{name}\ns, median (range)" for name in POLICIES), "ratio")
    for title, others in (("nothing beside", 0), ("a busy process a core beside", cores)):
        with busy(others):
            found = timed(repeats)
        one, many = (median(values) for values in found.values())
        told = (f"{median(values):.2f} ({min(values):.2f} to {max(values):.2f})" for values in found.values())
        table.add_row(title, *told, f"{many / one:.1f}")
    Console().print(table)


if __name__ == "__main__":
    main()
