"""What each command does: call, print, write."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from functools import partial
from importlib.resources import as_file, files
from pathlib import Path
from typing import TypeVar

from rich.console import Console

from torchrbd.cli.each import identify_each
from torchrbd.cli.exciting import design
from torchrbd.cli.exporting import export
from torchrbd.cli.files import REPORT, write_results
from torchrbd.cli.fleet import fleet
from torchrbd.cli.inspecting import inspect
from torchrbd.cli.interrupts import finishing_on_interrupt
from torchrbd.cli.progress import progress_bar
from torchrbd.cli.settings import settings_of
from torchrbd.cli.simulating import simulate_recording
from torchrbd.cli.statistics import merge, stats
from torchrbd.cli.tables import (
    print_changes,
    print_comparison,
    print_diagnosis,
    print_effects,
    print_identification,
)
from torchrbd.diagnosis import Comparison, Diagnosis, compare, diagnose
from torchrbd.effects import known_effects
from torchrbd.errors import OptionError
from torchrbd.export import write_changes
from torchrbd.inference import EstimatorComparison, Identification, compare_estimators, identify
from torchrbd.outputs import OutputFolder
from torchrbd.report import write_changes_report

Result = TypeVar("Result", Identification, Diagnosis, EstimatorComparison)


def _run(work: Callable[..., Result], show: Callable[[Result], None], options: argparse.Namespace) -> None:
    """Do the work on what the user gave, show the result and write it."""
    settings, into = settings_of(options), options.output
    with finishing_on_interrupt(), nullcontext() if into is None else OutputFolder(into) as folder:
        with progress_bar(quiet=options.quiet) as progress:
            result = work(options.robot, options.recordings, progress=progress, **settings)
        names = () if folder is None else folder.fill(partial(write_results, result))
    show(result)
    if into is not None:
        _tell(result, names, into)


def _identify(options: argparse.Namespace) -> None:
    """Identify one robot from all recordings, or from each on its own."""
    if options.each:
        identify_each(options)
        return
    if options.jobs is not None:
        raise OptionError("-j is for --each, which identifies each recording on its own; add it or leave -j out")
    _run(identify, print_identification, options)


def _demo(options: argparse.Namespace) -> None:
    with as_file(files("torchrbd") / "demo") as case:
        given = {"robot": case / "arm.urdf", "recordings": case / "fit.parquet", "holdout": case / "holdout.parquet"}
        _run(
            diagnose,
            print_diagnosis,
            argparse.Namespace(**given, config=None, output=options.output, quiet=options.quiet),
        )


def _compare(options: argparse.Namespace) -> None:
    """Say what changed between two diagnoses, and write it if a folder is given."""
    with nullcontext() if options.output is None else OutputFolder(options.output) as folder:
        result = compare(options.before, options.after)
        if folder is not None:
            folder.fill(partial(_write_changes, result))
    print_changes(result)
    if options.output is not None:
        _say(f"wrote comparison.json and comparison.html to {options.output}")


def _write_changes(result: Comparison, folder: Path) -> None:
    write_changes(result, folder / "comparison.json")
    write_changes_report(result, folder / "comparison.html")


def _say(words: str) -> None:
    Console(highlight=False, soft_wrap=True).print(words, markup=False)


def _compare_estimators(options: argparse.Namespace) -> None:
    _run(partial(compare_estimators, estimators=options.estimators), print_comparison, options)


def _tell(result: Identification | Diagnosis | EstimatorComparison, names: Sequence[str], folder: Path) -> None:
    """Name the files that were written."""
    _say(f"wrote {', '.join(names)} to {folder}")
    if not isinstance(result, EstimatorComparison):
        report = f"report: {(folder / REPORT).resolve()}"
        Console(highlight=False, soft_wrap=True).print(report, style="bold", markup=False)


COMMANDS: Mapping[str, Callable[[argparse.Namespace], None]] = {
    "identify": _identify,
    "diagnose": partial(_run, diagnose, print_diagnosis),
    "compare": _compare,
    "compare-estimators": _compare_estimators,
    "excite": design,
    "export": export,
    "inspect": inspect,
    "simulate": simulate_recording,
    "stats": stats,
    "merge": merge,
    "fleet": fleet,
    "effects": lambda _: print_effects(known_effects().values()),
    "demo": _demo,
}
"""What each command does with its options."""
