"""Every estimator on real robots: parameters of a URDF from some recordings, judged on the one left out.

    TORCHRBD_DATA=/path/to/recordings python examples/real_estimators.py --store

TORCHRBD_DATA names a folder with ``kuka_kr300``, ``dfki_double_pendulum`` and ``dfki_pendulum``; see real_recordings.py
for the first two; the third is from
github.com/dfki-ric-underactuated-lab/torque_limited_simple_pendulum (BSD-3-Clause).
Friction and torque offsets at every joint are fitted along.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
from real_recordings import PENDULUM_CUTOFF_HZ, data_folder
from real_robots import print_table
from rich.console import Console
from rich.progress import track

import torchrbd
from torchrbd import EstimatorComparison
from torchrbd.inference.torque_error import Fit

sys.path.append(str(Path(__file__).resolve().parents[1] / "benchmarks"))
import results_file

EFFECTS = ["viscous_friction", "coulomb_friction", "torque_offset"]
COLUMNS = ["estimator", "as found", "physical", "physical as found, splits"]
NAMES = ("kuka_kr300", "dfki_double_pendulum", "dfki_pendulum")


def data_sets(folder: Path) -> dict[str, tuple[Path, list[Path], dict[str, float]]]:
    """Return title -> URDF, recordings, options; without recordings of a changed robot or of compensated friction."""
    arm, double, single = (folder / name for name in ("kuka_kr300", "dfki_double_pendulum", "dfki_pendulum"))
    of_design_a = sorted(p for p in double.glob("A_20220812_*.csv") if "compensated" not in p.name)
    same_bob = sorted(p for p in single.glob("*.csv") if "1kg" not in p.name)
    return {
        "KUKA KR300, 6 joints": (arm / "robot.urdf", [arm / f"{name}.csv" for name in "ABC"], {}),
        "double pendulum A": (double / "robot_A.urdf", of_design_a, {"cutoff_hz": PENDULUM_CUTOFF_HZ}),
        "pendulum": (single / "robot.urdf", same_bob, {}),
    }


def compared(urdf: Path, recordings: list[Path], options: dict[str, float]) -> list[EstimatorComparison]:
    """Compare with every recording left out in turn."""
    return [
        torchrbd.compare_estimators(
            urdf, [r for r in recordings if r != judged], holdout=[judged], effects=EFFECTS, **options
        )
        for judged in track(recordings, urdf.parent.name, console=Console(stderr=True), transient=True)
    ]


def pooled(fits: list[Fit]) -> float:
    """Return the mean over the joints of squared error over torque variance, both averaged over the recordings."""
    error = np.mean([[fit.rmse[j] ** 2 for j in fits[0].nmse] for fit in fits], axis=0)
    variance = np.mean([[fit.rmse[j] ** 2 / fit.nmse[j] for j in fits[0].nmse] for fit in fits], axis=0)
    return float(np.mean(error / variance))


def rows_of(comparisons: list[EstimatorComparison]) -> list[list[str]]:
    """Return a row for each estimator: nmse as found, made physical, and how often it was physical as found."""
    splits, found = len(comparisons), []
    for k, row in enumerate(comparisons[0].rows):
        rows = [c.rows[k] for c in comparisons]
        raw, physical = ([r.raw for r in rows if r.raw], [r.physical for r in rows if r.physical])
        if len(raw) < splits:
            why = next(r.note for r in rows if r.raw is None).split(",")[0]
            found.append([row.name, f"cannot be used: {why}", "", ""])
            continue
        count = sum(bool(r.was_physical) for r in rows)
        often = "" if row.was_physical is None else f"{count} of {splits}"
        found.append([row.name, f"{pooled(raw):.3g}", f"{pooled(physical):.3g}", often])
    return found


def main() -> int:
    """Print the tables, and write them if asked to."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--store", action="store_true", help="write benchmarks/results/real_estimators.json")
    chosen = parser.parse_args()
    folder = data_folder()
    if folder is None:
        print("Set TORCHRBD_DATA to the folder of the recordings; see the head of this file for their sources.")
        return 2
    results = {}
    for (title, data), name in zip(data_sets(folder).items(), NAMES, strict=True):
        comparisons = compared(*data)
        results[name] = {"columns": COLUMNS, "rows": rows_of(comparisons)}
        print(f"{title}, {len(comparisons)} recordings, up to {comparisons[0].cutoff_hz:.2g} Hz")
        print_table(COLUMNS, results[name]["rows"])
    if chosen.store:
        results_file.update("real_estimators", "python examples/real_estimators.py --store", results)
    return 0


if __name__ == "__main__":
    sys.exit(main())
