"""Write cases to a folder: what a tool may see apart from the truth."""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from concurrent.futures import as_completed
from pathlib import Path

import pyarrow.parquet as pq
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from .cases import make_case
from .raw import cases as raw
from .workers import workers


def write_case(
    out: Path,
    of: str,
    tier: str,
    index: int,
    seed: int,
    options: raw.Options = raw.Options(),  # noqa: B008
) -> float:
    """Make and write one case; return the seconds it took. Options are those of the raw tier."""
    start = time.perf_counter()
    own = tier == raw.TIER
    case = raw.make_case(of, index, seed, options) if own else make_case(of, tier, index, seed)
    folder, truth = out / "cases" / case.id, out / "truth"
    folder.mkdir(parents=True, exist_ok=True)
    truth.mkdir(parents=True, exist_ok=True)
    (folder / "robot.urdf").write_text(case.urdf)
    if case.mapping:
        (folder / "mapping.yaml").write_text(case.mapping)
    for file, table in case.recordings.items():
        pq.write_table(table, folder / file, compression="zstd")
    # Last, so that a case with a truth is complete.
    (truth / f"{case.id}.json").write_text(json.dumps(case.truth, indent=1) + "\n")
    return time.perf_counter() - start


def generate(
    out: Path,
    of: str,
    tiers: Sequence[str],
    count: int,
    seed: int,
    jobs: int,
    options: raw.Options = raw.Options(),  # noqa: B008
) -> None:
    """Write ``count`` cases of each tier, with a progress bar."""
    done = {(t["set"], t["tier"], t["index"], t["seed"]) for t in map(_truth, sorted(out.glob("truth/*.json")))}
    wanted = [(of, tier, index, seed) for tier in tiers for index in range(count)]
    wanted = [case for case in wanted if case not in done]
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    seconds = []
    with Progress(*columns, TimeRemainingColumn()) as progress, workers(jobs) as pool:
        bar = progress.add_task("cases", total=len(wanted))
        for result in as_completed([pool.submit(write_case, out, *case, options) for case in wanted]):
            seconds.append(result.result())
            progress.update(bar, advance=1, description=f"cases ({sum(seconds) / len(seconds):.1f} s each)")
    print(f"{len(wanted)} cases, {sum(seconds) / max(1, len(seconds)):.2f} s each on one core")


def _truth(file: Path) -> dict[str, object]:
    return json.loads(file.read_text())
