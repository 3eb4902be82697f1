"""Rank what real robots' URDFs leave out, by log evidence.

    export TORCHRBD_DATA=/path/to/recordings
    python examples/rank_real.py emps kuka_kr300 panda

prints a table per robot: friction that every joint has, the clocks, and the leading hypotheses at the first and at the
last step. Sources of the recordings: examples/real_recordings.py.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Mapping
from pathlib import Path

from rich.console import Console
from rich.table import Table

import torchrbd

RECORDINGS = {
    "emps": ("train.csv",),
    "kuka_kr300": ("A.csv", "B.csv", "C.csv"),
    "panda": ("exciting_traj.csv",),
}
_SHOWN = 6


def numbers(parameters: Mapping[str, float]) -> str:
    """Return parameters by name, three digits each."""
    return ", ".join(f"{name} {value:.3g}" for name, value in parameters.items())


def show(robot: str, folder: Path, out: Console) -> None:
    """Rank one robot and print what leads."""
    start = time.perf_counter()
    found = torchrbd.rank_hypotheses(folder / "robot.urdf", [folder / name for name in RECORDINGS[robot]])
    out.print(f"\n[bold]{robot}[/bold]: up to {found.band_hz:g} Hz, {time.perf_counter() - start:.1f} s")
    for name, (delay, std) in found.delay_s.items():
        out.print(f"torque of {name} later by {1e3 * delay:.2f} ± {1.96e3 * std:.2f} ms")
    table = Table("step", "log evidence", "effect", "place", "parameters")
    for step, hypotheses in (("ordinary", found.ordinary), ("first", found.first), ("last", found.last)):
        for h in hypotheses if step == "ordinary" else hypotheses[:_SHOWN]:
            place = ", ".join((*h.joints, *h.links)) or "robot"
            table.add_row(step, f"{h.log_evidence:.1f}", h.effect, place, numbers(h.parameters))
    out.print(table)


def main() -> None:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("robots", nargs="+", choices=sorted(RECORDINGS))
    args = parser.parse_args()
    data = os.environ.get("TORCHRBD_DATA")
    if not data:
        parser.error("TORCHRBD_DATA names no folder; the recordings' sources are in examples/real_recordings.py")
    for robot in args.robots:
        show(robot, Path(data) / robot, Console(width=140))


if __name__ == "__main__":
    main()
