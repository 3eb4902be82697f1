"""Call, print, write: what the commands do that fit a robot to recordings, or compare what came of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from rich.console import Console

from torchrbd._runtime.outputs import OutputFolder
from torchrbd.cli.interrupts import finishing_on_interrupt
from torchrbd.cli.progress import progress_bar
from torchrbd.cli.tables import print_changes
from torchrbd.comparison import Comparison, compare
from torchrbd.diagnosis import Diagnosis
from torchrbd.export import write_changes
from torchrbd.inference import EstimatorComparison, Identification
from torchrbd.report import write_changes_report
from torchrbd.report.files import REPORT, write_files
from torchrbd.report.text.console import wrote

Result = TypeVar("Result", Identification, Diagnosis, EstimatorComparison)


def run(
    work: Callable[..., Result],
    show: Callable[[Result], None],
    robot: Path,
    recordings: Sequence[Path],
    output: Path | None,
    options: Mapping[str, Any],
    *,
    quiet: bool = False,
) -> None:
    """Do the work on what the user gave, show the result and write it."""
    with finishing_on_interrupt(), nullcontext() if output is None else OutputFolder(output) as folder:
        with progress_bar(quiet=quiet) as progress:
            result = work(robot, recordings, progress=progress, **options)
        names = () if folder is None else folder.fill(partial(write_files, result))
    show(result)
    if output is not None:
        _say(wrote(", ".join(names), output))
        if not isinstance(result, EstimatorComparison):
            report = f"report: {(output / REPORT).resolve()}"
            Console(highlight=False, soft_wrap=True).print(report, style="bold", markup=False)


def compare_results(before: Path, after: Path, output: Path | None) -> None:
    """Report what changed between two diagnoses, and write it if a folder is given."""
    with nullcontext() if output is None else OutputFolder(output) as folder:
        result = compare(before, after)
        if folder is not None:
            folder.fill(partial(_write_changes, result))
    print_changes(result)
    if output is not None:
        _say(wrote("comparison.json and comparison.html", output))


def _write_changes(result: Comparison, folder: Path) -> None:
    write_changes(result, folder / "comparison.json")
    write_changes_report(result, folder / "comparison.html")


def _say(words: str) -> None:
    Console(highlight=False, soft_wrap=True).print(words, markup=False)
