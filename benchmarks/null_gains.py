"""What the best candidate gains where nothing is missing: the numbers behind the thresholds of the search.

    python -m benchmarks.concealed generate --set development --tiers null --count 20 --seed 7 -o nulls
    python -m benchmarks.null_gains nulls

Beside friction and offsets at every joint each candidate is judged as the search judges it, whatever it needs to be
taken (``torchrbd/diagnosis/search/options.py``). Of every kind the best of each case is listed: gain in log-likelihood,
in standard errors over the blocks (t), and without the best two blocks.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import torch
from rich.console import Console
from rich.progress import track
from rich.table import Table

from benchmarks.concealed.run import recordings
from torchrbd.diagnosis.locate import stretches
from torchrbd.diagnosis.rows.samples import read_samples
from torchrbd.diagnosis.search.options import (
    LEAST_GAIN,
    LEAST_GAIN_IN_SOME,
    LEAST_REPEATED,
    LEAST_T,
    LEAST_WINDOWED_GAIN,
    SHORTLIST,
    Option,
    judged,
)
from torchrbd.diagnosis.search.partial import in_some_recordings, in_windows
from torchrbd.diagnosis.search.select import Search
from torchrbd.inference.identify import read_arguments
from torchrbd.inference.preparation import prepare
from torchrbd.physics import effects

LEAST = {
    "always": LEAST_GAIN,
    "loads and forces in a stretch of time": LEAST_WINDOWED_GAIN,
    "in some recordings only": LEAST_GAIN_IN_SOME,
    "functions without a law": LEAST_GAIN,
}


def best(case: Path) -> dict[str, Option | None]:
    """Return the option of each kind that gains most on a case."""
    fit, holdout = (list(map(str, files)) for files in recordings(case))
    robot, sources, settings = read_arguments(str(case / "robot.urdf"), fit, {"holdout": holdout}, "null_gains")
    prepared = prepare(robot, sources, settings, (), lambda *_: None)
    search = Search(read_samples(prepared, prepared.fit().pi), effects().values(), prepared.prior)
    beside = search.loaded(search.start)
    options = (
        search.options(beside),
        in_windows(search, beside, stretches(beside)),
        in_some_recordings(search, beside),
        [judged(beside, one.candidate) for one in search.screened_smooth(beside)[:SHORTLIST]],
    )
    return {kind: max(found, key=_total, default=None) for kind, found in zip(LEAST, options, strict=True)}


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
        ranked = sorted((o for one in found if (o := one[kind]) is not None), key=_total, reverse=True)
        for option in ranked[: options.most]:
            c, worth = option.candidate, option.worth
            needs = f"{least:g}, and t {LEAST_T:g} or {LEAST_REPEATED:g}"
            table.add_row(kind, needs, c.effect.id, *(f"{v:.1f}" for v in (worth.total, worth.t, worth.repeated)))
    Console().print(table)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
