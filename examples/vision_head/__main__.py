"""Run the experiment: ``python -m examples.vision_head --seeds 20``."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import torch
from rich.console import Console
from rich.progress import Progress

from . import tables
from .experiment import Conditions, run
from .methods import CLASSICAL, DEFAULT, methods
from .motion import RECORDED_NECK_HZ
from .robot import EFFECTS, Noise

sys.path.append(str(Path(__file__).resolve().parents[2] / "benchmarks"))
import results_file


def main() -> int:
    """Parse the command line, run, print, and write the result file if asked to."""
    everything = methods()
    parser = argparse.ArgumentParser(prog="python -m examples.vision_head", description=__doc__)
    parser.add_argument("--seeds", type=int, default=20, help="how many robots (default: 20)")
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--methods", nargs="+", metavar="NAME", help=f"some of: {', '.join(everything)}")
    parser.add_argument("--projected", action="store_true", help="make what classical methods find physical")
    parser.add_argument("--effects", default="", help=f"concealed ones, comma-separated: {', '.join(EFFECTS)}")
    parser.add_argument(
        "--neck-hz", type=float, nargs="+", default=[RECORDED_NECK_HZ], help="fastest recorded motion of the neck"
    )
    parser.add_argument("--encoder-noise", type=float, default=Noise.encoder, help="in the recording [rad]")
    parser.add_argument("--control-noise", type=float, default=0.0, help="of the encoders while controlling [rad]")
    parser.add_argument("--torque-noise", type=float, default=Noise.torque, help="part of each joint's RMS")
    parser.add_argument("--store", action="store_true", help="write benchmarks/results/vision_head.json")
    args = parser.parse_args()
    effects = tuple(filter(None, args.effects.split(",")))
    wanted = args.methods or list(everything)
    for name, known in [*((e, EFFECTS) for e in effects), *((m, everything) for m in wanted)]:
        if name not in known:
            parser.error(f"unknown '{name}'; known: {', '.join(known)}")
    if DEFAULT not in wanted or not set(wanted) & set(CLASSICAL):
        parser.error(f"--methods needs {DEFAULT} and at least one of {', '.join(CLASSICAL)}")
    chosen = {name: method for name, method in methods(args.projected).items() if name in wanted}

    torch.set_num_threads(1)  # the tensors are small
    out, runs = Console(highlight=False), []
    seeds = range(args.first_seed, args.first_seed + args.seeds)
    with Progress(console=out, disable=not out.is_terminal) as progress:
        for neck_hz in args.neck_hz:
            conditions = Conditions(Noise(args.encoder_noise, args.torque_noise), args.control_noise, neck_hz, effects)
            task = progress.add_task(tables.heading(conditions), total=len(seeds))
            results = run(chosen, conditions, seeds, lambda n, task=task: progress.update(task, completed=n))
            runs.append((conditions, results))
    for conditions, results in runs:
        out.rule(tables.heading(conditions))
        for controller in results.errors:
            out.print(tables.rich_table(controller, tables.columns(), tables.rows(results, controller)))
        out.print(tables.rich_table("against the best classical", tables.RATIO_COLUMNS, tables.ratios(results)))
        out.print(tables.verdict(results))
    if args.store:
        results_file.update(
            "vision_head", " ".join(["python -m examples.vision_head", *sys.argv[1:]]), tables.stored(runs)
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
