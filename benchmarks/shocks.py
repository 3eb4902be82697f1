"""How far shocks spoil the fit of the inertial parameters: the numbers behind the rule that leaves them out.

    python -m benchmarks.concealed generate --set development --tiers clean field null --count 40 --seed 7 -o dev
    python -m benchmarks.shocks dev

With friction and offsets at every joint each case is fitted with shocks and without. Listed are those in which the fit
without leaves least elsewhere, in parts of what the fit with them leaves there, and its misfit: what it leaves at
shocks, in parts of what it leaves elsewhere, at the joint where that is most (``torchrbd/diagnosis/rows/shocks.py``).
Not for final cases.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from rich.console import Console
from rich.progress import track
from rich.table import Table

from benchmarks.concealed.run import prepared
from torchrbd.diagnosis.rows.regression import fitted
from torchrbd.diagnosis.rows.samples import read_samples
from torchrbd.diagnosis.rows.shocks import MISFIT, SPOILED, calmed, left_elsewhere, misfit_ratio
from torchrbd.diagnosis.rows.weighing import weighed
from torchrbd.diagnosis.search.select import plain_background


class Spoiling(NamedTuple):
    """How far shocks spoil a case.

    Attributes:
        case, concealed: its name, and what is concealed in it.
        at_shocks: the part of its samples at shocks.
        left: what a fit without them leaves elsewhere, in parts of what one with them leaves there.
        misfit: what it leaves at them, in parts of what it leaves elsewhere.
    """

    case: str
    concealed: str
    at_shocks: float
    left: float
    misfit: float


def spoiling(folder: Path, name: str) -> Spoiling:
    """Fit a case with shocks and without."""
    data = prepared(folder / "cases" / name, "shocks")
    samples = read_samples(data, data.fit().pi)
    with_them = weighed(fitted(samples, data.prior, plain_background(samples)))
    calm = calmed(with_them)
    truth = json.loads((folder / "truth" / f"{name}.json").read_text(encoding="utf-8"))
    concealed = ", ".join(f"{e['effect']} {e['size']:.2f}" for e in truth["effects"])
    at_shocks = 1.0 - float(calm.rows.samples.weight.any(0).mean())
    return Spoiling(name, concealed, at_shocks, left_elsewhere(with_them, calm), float(misfit_ratio(calm).max()))


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="+", type=Path, metavar="DIR", help="folders of concealed cases")
    parser.add_argument("--rows", type=int, default=20, help="how many cases to list (default: 20)")
    options = parser.parse_args(arguments)
    cases = [(folder, path.name) for folder in options.folders for path in sorted((folder / "cases").iterdir())]
    found = sorted((spoiling(*case) for case in track(cases, "fitting")), key=lambda one: one.left)
    rule = f"{len(cases)} cases; spoiled where less than {SPOILED} is left elsewhere and misfit exceeds {MISFIT}"
    table = Table("case", "concealed", "at shocks", "left elsewhere", "misfit", title=rule)
    for one in found[: options.rows]:
        table.add_row(one.case, one.concealed, f"{100 * one.at_shocks:.0f} %", f"{one.left:.2f}", f"{one.misfit:.1f}")
    Console().print(table)


if __name__ == "__main__":
    main()
