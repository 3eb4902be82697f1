"""How far shocks spoil fits, and what the search finds all the same: the numbers behind the rule that leaves them out.

    python -m benchmarks.concealed generate --set development --tiers clean field null --count 40 --seed 7 -o dev
    python -m benchmarks.shocks dev

With friction and offsets at every joint each case is fitted with shocks and without. Where the fit without leaves less
elsewhere, the search is run, and what it has found is fitted both ways. Listed is, for plain friction and for what was
found, what the fit without shocks leaves elsewhere, in parts of what the one with them leaves there, and of what was
found its misfit: what it leaves at shocks, in parts of what it leaves elsewhere, at the joint where that is most
(``torchrbd/diagnosis/rows/shocks.py``). Not for final cases.
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
from torchrbd.diagnosis.rows.samples import read_samples
from torchrbd.diagnosis.rows.shocks import MISFIT, SPOILED, calmed, left_elsewhere, misfit_ratio
from torchrbd.diagnosis.search.select import Search
from torchrbd.physics import effects

# A search is run where shocks cost plain friction so much.
LESS = 0.9


class Spoiling(NamedTuple):
    """How far shocks spoil a case.

    Attributes:
        case, concealed: its name, and what is concealed in it.
        at_shocks: the part of its samples at shocks.
        plain: what a fit of plain friction without them leaves elsewhere, in parts of what one with them leaves there.
        found: the same of what the search has found; as ``plain`` where no search was run.
        misfit: what that leaves at shocks, in parts of what it leaves elsewhere.
    """

    case: str
    concealed: str
    at_shocks: float
    plain: float
    found: float
    misfit: float


def spoiling(folder: Path, name: str) -> Spoiling:
    """Fit a case with shocks and without."""
    data = prepared(folder / "cases" / name, "shocks")
    search = Search(read_samples(data, data.fit().pi), effects().values(), data.prior)
    fit, calm = search.start, calmed(search.start)
    plain = left_elsewhere(fit, calm)
    if plain < LESS:
        fit = search.run()
        calm = calmed(fit)
    truth = json.loads((folder / "truth" / f"{name}.json").read_text(encoding="utf-8"))
    concealed = ", ".join(f"{e['effect']} {e['size']:.2f}" for e in truth["effects"])
    at_shocks = 1.0 - float(calm.rows.samples.weight.any(0).mean())
    return Spoiling(name, concealed, at_shocks, plain, left_elsewhere(fit, calm), float(misfit_ratio(calm).max()))


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="+", type=Path, metavar="DIR", help="folders of concealed cases")
    options = parser.parse_args(arguments)
    cases = [(folder, path.name) for folder in options.folders for path in sorted((folder / "cases").iterdir())]
    found = sorted((spoiling(*case) for case in track(cases, "fitting")), key=lambda one: one.found)
    rule = f"{len(cases)} cases; left out where less than {SPOILED} is left elsewhere and misfit exceeds {MISFIT}"
    table = Table("case", "concealed", "at shocks", "plain friction", "what was found", "misfit", title=rule)
    for one in found:
        if one.plain < LESS:
            share, numbers = f"{100 * one.at_shocks:.0f} %", (f"{v:.2f}" for v in (one.plain, one.found))
            table.add_row(one.case, one.concealed, share, *numbers, f"{one.misfit:.1f}")
    Console().print(table)


if __name__ == "__main__":
    main()
