"""What each command does: call, print, write."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from importlib.resources import as_file, files
from pathlib import Path
from typing import TypeVar

from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from torchrbd.cli.exporting import export
from torchrbd.cli.settings import settings_of
from torchrbd.cli.tables import (
    print_changes,
    print_comparison,
    print_diagnosis,
    print_effects,
    print_identification,
)
from torchrbd.diagnosis import Diagnosis, compare, diagnose
from torchrbd.export import save_model, to_urdf, write_changes, write_diagnosis, write_parameters
from torchrbd.export.json_files import write_comparison
from torchrbd.inference import EstimatorComparison, Identification, compare_estimators, identify
from torchrbd.physics import effects
from torchrbd.report import write_changes_report, write_report

Result = TypeVar("Result", Identification, Diagnosis, EstimatorComparison)


def _run(work: Callable[..., Result], show: Callable[[Result], None], options: argparse.Namespace) -> None:
    """Do the work on what the user gave, show the result and write it."""
    settings = settings_of(options)
    with _progress() as progress:
        result = work(options.robot, options.recordings, progress=progress, **settings)
    show(result)
    _write(result, options.output)


def _demo(options: argparse.Namespace) -> None:
    with as_file(files("torchrbd") / "demo") as case:
        given = {"robot": case / "arm.urdf", "recordings": case / "fit.parquet", "holdout": case / "holdout.parquet"}
        _run(diagnose, print_diagnosis, argparse.Namespace(**given, config=None, output=options.output))


def _compare(options: argparse.Namespace) -> None:
    """Say what changed between two diagnoses, and write it if a folder is given."""
    result, folder = compare(options.before, options.after), options.output
    print_changes(result)
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
        write_changes(result, folder / "comparison.json")
        write_changes_report(result, folder / "comparison.html")
        _say(f"wrote comparison.json and comparison.html to {folder}")


def _say(words: str) -> None:
    Console(highlight=False, soft_wrap=True).print(words, markup=False)


def _compare_estimators(options: argparse.Namespace) -> None:
    _run(partial(compare_estimators, estimators=options.estimators), print_comparison, options)


@contextmanager
def _progress() -> Iterator[Callable[[str, float], None]]:
    """Show one bar on a terminal, and nothing where the output is not one."""
    columns = (SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    console = Console(stderr=True)
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("reading", total=None)

        def report(stage: str, part: float) -> None:
            bar.update(task, description=stage, total=1.0 if part else None, completed=part)

        yield report


def _write(result: Identification | Diagnosis | EstimatorComparison, folder: Path | None) -> None:
    """Write every result file and name them."""
    if folder is None:
        return
    out = Console(highlight=False, soft_wrap=True)
    folder.mkdir(parents=True, exist_ok=True)
    if isinstance(result, EstimatorComparison):
        write_comparison(result, folder / "estimators.json")
        out.print(f"wrote estimators.json to {folder}", markup=False)
        return
    identification = result.identification if isinstance(result, Diagnosis) else result
    write_parameters(identification, folder / "parameters.json")
    (folder / "identified.urdf").write_bytes(to_urdf(identification.model))
    save_model(identification.model, folder / "model.safetensors")
    names = ["parameters.json", "identified.urdf", "model.safetensors"]
    if isinstance(result, Diagnosis):
        write_diagnosis(result, folder / "diagnosis.json")
        names.append("diagnosis.json")
    write_report(result, folder / "report.html")
    out.print(f"wrote {', '.join(names)} to {folder}", markup=False)
    out.print(f"report: {(folder / 'report.html').resolve()}", style="bold", markup=False)


COMMANDS: Mapping[str, Callable[[argparse.Namespace], None]] = {
    "identify": partial(_run, identify, print_identification),
    "diagnose": partial(_run, diagnose, print_diagnosis),
    "compare": _compare,
    "compare-estimators": _compare_estimators,
    "export": export,
    "effects": lambda _: print_effects(effects().values()),
    "demo": _demo,
}
"""What each command does with its options."""
