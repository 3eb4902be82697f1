"""Generate the concealed benchmark.

    python -m benchmarks.concealed generate --set development --tiers field null --count 20 --seed 0 -o DIR

writes DIR/cases/<id>/{robot.urdf, fit_1.parquet, ..., holdout.parquet}, all that a tool may see, and
DIR/truth/<id>.json, which truth.py documents. Cases that are there already are kept. Needs the test extra.

The raw tier comes from a generator of its own; each 24 of its cases hold every one of its effects once, and 4 nulls:

    python -m benchmarks.concealed generate --set development --tiers raw --count 48 --seed 0 -o DIR
"""

from __future__ import annotations

import argparse
from pathlib import Path

from .generate import generate
from .raw.cases import TIER, Options
from .robots import SETS
from .tiers import TIERS


def main() -> None:
    """Parse the command line and generate."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.concealed", description="The concealed benchmark.")
    command = parser.add_subparsers(required=True).add_parser("generate", help="write cases and their truth")
    command.add_argument("--set", dest="of", choices=SETS, default="development")
    command.add_argument("--tiers", nargs="+", choices=(*TIERS, TIER), default=list(TIERS))
    command.add_argument("--count", type=int, default=20, help="cases of each tier")
    command.add_argument("--seed", type=int, default=0)
    command.add_argument("--workers", type=int, default=1, help="processes")
    command.add_argument(
        "--sizes", nargs="+", type=float, default=[0.08], help="raw: parts of the joint's torque, in turns"
    )
    command.add_argument("--inertials", type=float, default=0.2, help="raw: how far the URDF's are off")
    command.add_argument("-o", "--out", type=Path, required=True)
    args = parser.parse_args()
    generate(
        args.out, args.of, args.tiers, args.count, args.seed, args.workers, Options(tuple(args.sizes), args.inertials)
    )


if __name__ == "__main__":
    main()
