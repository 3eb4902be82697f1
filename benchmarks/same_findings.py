"""Do findings follow rounding? Recordings are diagnosed again with their torque changed by a part in 1e9.

    TORCHRBD_DATA=/path/to/recordings python benchmarks/same_findings.py emps ur10 panda -n 20

Writes ``benchmarks/results/same_findings.json``: of each set, in how many of n diagnoses the findings are those of the
recording as it is. Two findings are the same if effect, joints, links and recordings are, and their windows of time to
a second. Sets are those of ``tests/real_sets.py``.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import results_file
from rich.progress import track

import torchrbd
from torchrbd import Diagnosis, Finding

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))

import real_sets

RELATIVE = 1e-9


def perturb(recording: Path, folder: Path, seed: int) -> Path:
    """Write a recording whose torques are multiplied by 1 + 1e-9 N(0, 1), each row by another number."""
    table = pd.read_csv(recording, comment="#") if recording.suffix == ".csv" else pd.read_parquet(recording)
    rng = np.random.default_rng(seed)
    for name in (c for c in table.columns if c.startswith("tau_")):
        table[name] *= 1.0 + RELATIVE * rng.standard_normal(len(table))
    path = folder / f"{recording.stem}.parquet"
    table.to_parquet(path)
    return path


def identity(one: Finding) -> tuple[Any, ...]:
    """Return what makes a finding that finding."""
    times = None if one.where.time_s is None else tuple((round(a), round(b)) for a, b in one.where.time_s)
    names = None if one.where.recordings is None else tuple(Path(name).stem for name in one.where.recordings)
    return one.effect, one.joints, one.links, names, times


def findings(found: Diagnosis) -> set[tuple[Any, ...]]:
    return {identity(one) for one in found.findings}


def repeat(name: str, case: real_sets.Case, n: int) -> Mapping[str, Any]:
    """Diagnose a set and n copies of it."""

    def diagnosed(fitted: Sequence[Path]) -> set[tuple[Any, ...]]:
        more = {"holdout": case.holdout} if case.holdout else {}
        return findings(torchrbd.diagnose(case.robot, list(fitted), **case.options, **more))

    first, others = diagnosed(case.recordings), list[set[tuple[Any, ...]]]()
    for seed in track(range(n), description=name):
        with tempfile.TemporaryDirectory() as folder:
            others.append(diagnosed([perturb(path, Path(folder), seed) for path in case.recordings]))
    differ = {str(one) for other in others for one in other ^ first}
    return {"findings": len(first), "n": n, "same": sum(other == first for other in others), "differ": sorted(differ)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sets", nargs="+", choices=sorted(real_sets.CASES), help="real recordings")
    parser.add_argument("-n", type=int, default=20, help="diagnoses of each (default: 20)")
    args = parser.parse_args()
    data = real_sets.data_folder()
    if data is None:
        parser.error("TORCHRBD_DATA does not name a folder")
    for name in args.sets:
        with tempfile.TemporaryDirectory() as folder:
            result = repeat(name, real_sets.CASES[name](data, Path(folder)), args.n)
        print(
            f"{name}: the same findings in {result['same']} of {result['n']}; {', '.join(result['differ']) or 'none'}"
        )
        command = f"python benchmarks/same_findings.py {name} -n {args.n}"
        results_file.update("same_findings", command, {name: result})


if __name__ == "__main__":
    main()
