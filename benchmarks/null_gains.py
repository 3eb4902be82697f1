"""What the best candidate gains where nothing is missing: the numbers behind the thresholds of the search.

    python -m benchmarks.concealed generate --set development --tiers null --count 20 --seed 7 -o nulls
    python -m benchmarks.null_gains nulls

Beside friction and offsets at every joint each candidate is judged as the search judges it, whatever it needs to be
taken (``torchrbd/diagnosis/search/options.py``). Of every kind the best of each case is listed: gain in log-likelihood,
in standard errors over the blocks (t), and without the best two blocks. Of what friction and offsets leave, the line in
a spectrum that chance gives least often (``torchrbd/diagnosis/locate/hum.py``) and the largest slow part, in parts of
the joint's torque RMS (``torchrbd/diagnosis/locate/wander.py``).
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import torch
from rich.console import Console
from rich.progress import track
from rich.table import Table

from benchmarks.concealed.run import prepared
from torchrbd.diagnosis.locate import stretches
from torchrbd.diagnosis.locate.hum import CHANCE, lines
from torchrbd.diagnosis.locate.wander import DRIFT, slow_parts
from torchrbd.diagnosis.rows.samples import read_samples
from torchrbd.diagnosis.search.options import (
    LEAST_GAIN,
    LEAST_GAIN_AT_TIMES,
    LEAST_NAMED_GAIN,
    LEAST_REPEATED,
    LEAST_T,
    SHORTLIST,
    Option,
    judged,
)
from torchrbd.diagnosis.search.partial import in_windows
from torchrbd.diagnosis.search.select import Search
from torchrbd.physics import effects

LEAST = {
    "always": LEAST_NAMED_GAIN,
    "loads and forces in a stretch of time": LEAST_GAIN_AT_TIMES,
    "in some recordings only": LEAST_GAIN_AT_TIMES,
    "functions without a law": LEAST_GAIN,
}


class Null(NamedTuple):
    """What looks most like something where nothing is.

    Attributes:
        options: of each kind the one that gains most.
        line: of a spectrum, how often chance gives it.
        slow: part of a joint's torque RMS, the largest.
    """

    options: dict[str, Option | None]
    line: float
    slow: float


def best(case: Path) -> Null:
    """Return what looks most like something in a case."""
    data = prepared(case, "null_gains")
    search = Search(read_samples(data, data.fit().pi), effects().values(), data.prior)
    beside = search.loaded(search.start)
    options = (
        search.options(beside),
        in_windows(search, beside, stretches(beside)),
        search.in_some_recordings(beside),
        [judged(beside, one.candidate) for one in search.screened_smooth(beside)[:SHORTLIST]],
    )
    return Null(
        {kind: max(found, key=_total, default=None) for kind, found in zip(LEAST, options, strict=True)},
        min((line.chance for _, line in lines(beside, 1.0)), default=1.0),
        max((slow.part for slow in slow_parts(beside).values()), default=0.0),
    )


def _total(option: Option) -> float:
    return option.worth.total


def main(arguments: Sequence[str] | None = None) -> int:
    """List the best of every case, the largest gains first."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="+", type=Path, metavar="DIR", help="with cases")
    parser.add_argument("--most", type=int, default=5, help="cases to list of each kind")
    options = parser.parse_args(arguments)
    torch.set_num_threads(1)
    cases = [case for folder in options.folders for case in sorted((folder / "cases").iterdir())]
    found = [best(case) for case in track(cases, "searching nulls", console=Console(stderr=True))]
    table = Table("kind", "needs", "best", "gain", "t", "without two blocks", title=f"{len(cases)} cases with nothing")
    for kind, least in LEAST.items():
        ranked = sorted((o for one in found if (o := one.options[kind]) is not None), key=_total, reverse=True)
        for option in ranked[: options.most]:
            c, worth = option.candidate, option.worth
            needs = f"{least:g}, and t {LEAST_T:g} or {LEAST_REPEATED:g}"
            table.add_row(kind, needs, c.effect.id, *(f"{v:.1f}" for v in (worth.total, worth.t, worth.repeated)))
    spectra = Table("in a spectrum", "needs", "most")
    chances, slow = sorted(one.line for one in found), sorted((one.slow for one in found), reverse=True)
    spectra.add_row(
        "hum: how often chance gives it", f"{CHANCE:g}", ", ".join(f"{v:.1g}" for v in chances[: options.most])
    )
    spectra.add_row("slow part of the torque", f"{DRIFT:g}", ", ".join(f"{v:.2g}" for v in slow[: options.most]))
    Console().print(table, spectra)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
