"""What each command does: call, print, write."""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from importlib.resources import as_file, files
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from torchrbd.cli.options import parser, settings_of
from torchrbd.cli.tables import print_comparison, print_diagnosis, print_fits
from torchrbd.diagnosis import Diagnosis, diagnose
from torchrbd.errors import OptionError, TorchRBDError
from torchrbd.export import save_model, to_urdf, write_diagnosis, write_parameters
from torchrbd.inference import Identification, identify
from torchrbd.inference.comparison import compare_estimators
from torchrbd.report import write_report


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code."""
    options = parser(_RUNS).parse_args(arguments)
    errors = Console(stderr=True, highlight=False, soft_wrap=True)
    try:
        if options.output is not None:
            _check_output(options.output)
        options.run(options)
    except (TorchRBDError, OSError) as error:
        errors.print("torchrbd: error:", style="bold red", end=" ")
        errors.print(str(error), markup=False)
        return 2
    except KeyboardInterrupt:
        errors.print("torchrbd: interrupted")
        return 130
    return 0


def _check_output(folder: Path) -> None:
    """Refuse, before any work is done, a folder that cannot be written."""
    existing = next(path for path in (folder, *folder.absolute().parents) if path.exists())
    if not existing.is_dir() or not os.access(existing, os.W_OK):
        raise OptionError(f"output '{folder}': '{existing}' is not a folder that can be written; name another")


def _identify(options: argparse.Namespace) -> None:
    settings = settings_of(options)
    with _progress() as progress:
        result = identify(options.robot, options.recordings, progress=progress, **settings)
    print_fits(result)
    _write(result, options.output)


def _diagnose(options: argparse.Namespace) -> None:
    settings = settings_of(options)
    with _progress() as progress:
        result = diagnose(options.robot, options.recordings, progress=progress, **settings)
    print_diagnosis(result)
    _write(result, options.output)


def _compare(options: argparse.Namespace) -> None:
    settings = settings_of(options)
    with _progress() as progress:
        result = compare_estimators(
            options.robot, options.recordings, estimators=options.estimators, progress=progress, **settings
        )
    print_comparison(result)
    if options.output is not None:
        options.output.mkdir(parents=True, exist_ok=True)
        file = options.output / "estimators.json"
        content = json.dumps({"schema": 1, **asdict(result)}, indent=1, ensure_ascii=False)
        file.write_text(content + "\n", encoding="utf-8")
        Console(highlight=False, soft_wrap=True).print(f"wrote {file}", markup=False)


def _demo(options: argparse.Namespace) -> None:
    with as_file(files("torchrbd") / "demo") as case, _progress() as progress:
        result = diagnose(
            case / "arm.urdf", case / "fit.parquet", holdout=[case / "holdout.parquet"], progress=progress
        )
    print_diagnosis(result)
    _write(result, options.output)


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


def _write(result: Identification | Diagnosis, folder: Path) -> None:
    """Write every result file and name them."""
    identification = result.identification if isinstance(result, Diagnosis) else result
    folder.mkdir(parents=True, exist_ok=True)
    write_parameters(identification, folder / "parameters.json")
    (folder / "identified.urdf").write_bytes(to_urdf(identification.model))
    save_model(identification.model, folder / "model.safetensors")
    names = ["parameters.json", "identified.urdf", "model.safetensors"]
    if isinstance(result, Diagnosis):
        write_diagnosis(result, folder / "diagnosis.json")
        names.append("diagnosis.json")
    write_report(result, folder / "report.html")
    out = Console(highlight=False, soft_wrap=True)
    out.print(f"wrote {', '.join(names)} to {folder}", markup=False)
    out.print(f"report: {(folder / 'report.html').resolve()}", style="bold", markup=False)


_RUNS = {"identify": _identify, "diagnose": _diagnose, "compare-estimators": _compare, "demo": _demo}
