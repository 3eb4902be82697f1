"""What is named from set-points and gains alone, over what is named from torques: the same simulated robots twice.

    OMP_NUM_THREADS=1 python -m benchmarks.simulated_drives FOLDER [--count 20] [--seed 4001] [-j 2]

Cases of the raw tier of ``concealed``, on arms that development does not use: friction that the URDF lacks at all
joints and one more effect of 8 % of its joint's torque, or none. Each is diagnosed from torques with 3 % of noise, and
from the set-points of proportional-derivative drives with known gains and a known delay of 0 to 4 samples.

Criteria, written down before the first run: what is named from set-points is at least .9 of what is named from torques;
95 % intervals hold the truth in .90 to .98.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks import results_file
from benchmarks.concealed.figures import rate
from benchmarks.concealed.generate import write_case
from benchmarks.concealed.raw import cases
from benchmarks.concealed.run import DIAGNOSIS, SECONDS, diagnose_case, for_each_case
from benchmarks.concealed.score import CaseScore, score_case

# Effects of one joint. Errors of a torque sensor do not exist here; the other kinds are left out to keep the run short.
KINDS = (
    "stribeck_friction",
    "load_dependent_friction",
    "quadratic_drag",
    "position_dependent_friction",
    "presliding_hysteresis",
    "joint_spring",
    "one_sided_spring",
    "torque_ripple",
    None,
)
WAYS = {"torques": False, "set-points": True}


def main() -> None:
    """Make the cases, diagnose each in both ways, and write what is named."""
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", type=Path)
    parser.add_argument("--count", type=int, default=20, help="robots")
    parser.add_argument("--seed", type=int, default=4001)
    parser.add_argument("-j", "--jobs", type=int, default=1, help="processes")
    args = parser.parse_args()
    wanted = [k for k in range(10 * args.count) if cases.kind_of(k, args.seed, "final")[0] in KINDS][: args.count]
    rows = {}
    for way, drives in WAYS.items():
        folder, out = args.folder / way, args.folder / f"{way}-diagnosed"
        for index in wanted:
            write_case(folder, "final", cases.TIER, index, args.seed, cases.Options(drives=drives))
        for_each_case(folder, out, DIAGNOSIS, diagnose_case, jobs=args.jobs)
        rows[way] = summary([_scored(truth, out) for truth in sorted(folder.glob("truth/*.json"))])
        print(way, rows[way])
    command = f"python -m benchmarks.simulated_drives FOLDER --count {args.count} --seed {args.seed}"
    results_file.update("simulated_drives", command, rows)


def _scored(truth: Path, out: Path) -> CaseScore:
    content, own = json.loads(truth.read_text()), out / truth.stem
    seconds = json.loads((own / SECONDS).read_text())["seconds"]
    return score_case(content, json.loads((own / DIAGNOSIS).read_text()), seconds)


def summary(scores: Sequence[CaseScore]) -> dict[str, Any]:
    """Return rates over cases: named exactly or in class, false findings, and intervals that hold the truth."""
    effects = [e for one in scores for e in one.effects]
    return {
        "robots": len(scores),
        "errors": sum(one.error is not None for one in scores),
        "named or in class": _numbers([e.in_class for e in effects]),
        "cases with a false finding": _numbers([bool(one.false) for one in scores]),
        "friction of other joints found": _numbers([b for one in scores for b in one.background]),
        "95 % intervals that hold the truth": _numbers([c for e in effects for c in e.covered]),
        "missed": [f"{one.case} {e.effect}" for one in scores for e in one.effects if not e.in_class],
        "false": [f"{one.case} {' at '.join(f[:2])}" for one in scores for f in one.false],
    }


def _numbers(hits: Sequence[bool]) -> dict[str, float]:
    found = rate(hits)
    return {"value": round(found.value, 3), "low": round(found.low, 3), "high": round(found.high, 3), "of": len(hits)}


if __name__ == "__main__":
    main()
