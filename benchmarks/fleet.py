"""Time identify_many against a loop over identify: one robot, many recordings.

    OMP_NUM_THREADS=1 python benchmarks/fleet.py [--counts 1 10 100 1000]

A six-joint arm with friction, 30 s at 125 Hz in a Parquet file each. The loop runs half before and half after
identify_many, so that a machine whose speed varies is about as fast for both; imports and the first run of this
process do not count, those of its helpers do. Where other programs keep the cores busy the ratio is theirs too; the
seconds of processor time are less so: their sum over the cores is what a free machine would take. "apart" is the
largest difference of any parameter between the two, in parts of its standard deviation. Needs the test extra.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

import import_paths  # noqa: F401
import numpy as np
import pyarrow as pa
from pyarrow import parquet
from rich.console import Console
from rich.table import Table
from simulated import Motion, record, with_wrong_inertials

import torchrbd


def friction(motion: Motion) -> np.ndarray:
    """Return viscous and Coulomb friction (N, n)."""
    return 0.3 * motion.qd + 0.8 * np.sign(motion.qd)


def write(urdf: str, seed: int, folder: Path, seconds: float, rate_hz: float) -> Path:
    """Record a motion and write it."""
    recording = record(urdf, seed, extra=friction, duration_s=seconds, rate_hz=rate_hz)
    (chunk,) = recording.chunks(10**8)
    columns = {"t": chunk.t}
    for k, joint in enumerate(recording.joints):
        columns |= {f"q_{joint}": chunk.q[:, k], f"tau_{joint}": chunk.tau[:, k]}
    path = folder / f"run{seed}.parquet"
    parquet.write_table(pa.table(columns), path)
    return path


def clocks() -> np.ndarray:
    """Return seconds that have passed, and those that processors spent on this process and on helpers that ended."""
    return np.array([time.perf_counter(), sum(os.times()[:4])])


def compared(robot: torchrbd.RobotModel, recordings: Sequence[Path], jobs: int | None) -> tuple[float, ...]:
    """Return seconds and processor seconds of the loop, those of identify_many, and how far their parameters are
    apart."""
    half = (len(recordings) + 1) // 2
    loop, spent, many_spent = [], np.zeros(2), np.zeros(2)
    for part in (recordings[:half], None, recordings[half:]):
        start = clocks()
        if part is None:
            many = [one.result().parameters for one in torchrbd.identify_many(robot, recordings, jobs=jobs)]
            many_spent = clocks() - start
        else:
            loop += [torchrbd.identify(robot, recording).parameters for recording in part]
            spent += clocks() - start
    pairs = [(a, b) for one, other in zip(loop, many, strict=True) for a, b in zip(one, other, strict=True)]
    return *spent, *many_spent, max(abs(a.value - b.value) / a.std for a, b in pairs if a.std > 0)


def main() -> None:
    """Print seconds and ratios."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--counts", type=int, nargs="+", default=[1, 10, 100], metavar="N", help="of recordings")
    options.add_argument("--jobs", type=int, metavar="N", help="processes (default: one a core)")
    options.add_argument("--seconds", type=float, default=30.0, metavar="S", help="of a recording")
    options.add_argument("--rate", type=float, default=125.0, metavar="HZ", help="of a recording")
    given = options.parse_args()
    urdf = (files("torchrbd") / "demo" / "arm.urdf").read_text()
    robot = torchrbd.RobotModel.from_urdf(with_wrong_inertials(urdf, 3).encode())
    titles = "recordings", "loop\ns", "many\ns", "ratio", "runs", "loop\nCPU s", "many\nCPU s", "apart\nstd"
    console, table = Console(), Table(*titles)
    with TemporaryDirectory() as folder:
        written = [write(urdf, k, Path(folder), given.seconds, given.rate) for k in range(max(given.counts))]
        torchrbd.identify(robot, written[0])
        for count in given.counts:
            runs = [compared(robot, written[:count], given.jobs) for _ in range(5 if count == 1 else 1 + 20 // count)]
            loop, loop_cpu, many, many_cpu, apart = (median(column) for column in zip(*runs, strict=True))
            ratios = sorted(run[0] / run[2] for run in runs)
            spread = f"{len(runs)}, {ratios[0]:.2f} to {ratios[-1]:.2f}"
            numbers = (f"{x:.1f}" for x in (loop_cpu, many_cpu))
            row = f"{count}", f"{loop:.1f}", f"{many:.1f}", f"{median(ratios):.2f}", spread, *numbers, f"{apart:.0e}"
            table.add_row(*row)
            console.print(*row)
    console.print(f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f} at the end")
    console.print(table)


if __name__ == "__main__":
    main()
