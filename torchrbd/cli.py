"""The command line: parse, call, print. Exit code 0 when the work was done, 2 for input that cannot be used."""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from importlib.resources import as_file, files
from pathlib import Path
from typing import Any

import yaml
from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
from rich.table import Table
from rich_argparse import RichHelpFormatter

from torchrbd import __version__
from torchrbd.diagnosis import Diagnosis, diagnose
from torchrbd.diagnosis.words import interval, number, words_of
from torchrbd.errors import OptionError, TorchRBDError
from torchrbd.export import save_model, to_urdf, write_diagnosis, write_parameters
from torchrbd.inference import Identification, Settings, identify
from torchrbd.physics import effects
from torchrbd.report import write_report
from torchrbd.report.words import percent


class _Help(RichHelpFormatter):
    """Help in colours, in which [m] is a unit."""

    help_markup = text_markup = False


_MODEL_WORDS = {"urdf": "URDF", "rigid_body": "re-fitted", "extended": "extended"}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code."""
    options = _parser().parse_args(arguments)
    errors = Console(stderr=True, highlight=False, soft_wrap=True)
    try:
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


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        "torchrbd",
        description="Find, name and model the physics that a robot's URDF leaves out.",
        formatter_class=_Help,
    )
    parser.add_argument("--version", action="version", version=f"torchrbd {__version__}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    def command(name: str, run: Callable[[argparse.Namespace], None], words: str) -> argparse.ArgumentParser:
        sub = commands.add_parser(name, help=words, description=words, formatter_class=_Help)
        sub.set_defaults(run=run)
        return sub

    sub = command(
        "identify", _identify, "Fit the inertial parameters of a URDF to recordings; always physically valid."
    )
    _add_shared(sub, "effects to fit beside the inertial parameters, at every joint (default: none)")
    sub = command("diagnose", _diagnose, "Find, name and model what the URDF leaves out.")
    _add_shared(sub, "effects that the search may use (default: all)")
    sub = command(
        "demo", _demo, "Diagnose a bundled case: a six-joint arm with a friction that its URDF does not hold."
    )
    sub.add_argument(
        "-o", "--output", type=Path, default=Path("torchrbd-demo"), metavar="DIR", help="(default: %(default)s)"
    )
    return parser


def _add_shared(sub: argparse.ArgumentParser, effects_words: str) -> None:
    sub.add_argument("robot", type=Path, metavar="ROBOT.urdf", help="what the simulator believes")
    sub.add_argument(
        "recordings",
        nargs="+",
        type=Path,
        metavar="RECORDING",
        help="CSV, Parquet or NPZ with columns t [s], q_<joint> [rad, m], tau_<joint> [N m, N], optionally qd_<joint>",
    )
    sub.add_argument("-o", "--output", type=Path, required=True, metavar="DIR", help="folder for the results")
    data = sub.add_argument_group("data")
    many: dict[str, Any] = {"nargs": "+", "action": "extend"}
    data.add_argument("--holdout", type=Path, metavar="FILE", help="recordings that no fit or choice sees", **many)
    data.add_argument(
        "--holdout-fraction", type=float, metavar="X", help="else, the part of each recording kept back (default: 0.25)"
    )
    data.add_argument("--time", metavar="A:B", help="use only these seconds of each recording")
    data.add_argument("--joints", metavar="JOINT", help="joints whose torque counts (default: all)", **many)
    data.add_argument(
        "--payload",
        metavar="FILE=kg,x,y,z[@LINK]",
        help="known load in a recording: mass and centre [kg, m] on a link (default: a chain's last)",
        **many,
    )
    data.add_argument(
        "--mapping", type=Path, metavar="YAML", help="other column names, units, signs, gear ratios, torque constants"
    )
    data.add_argument(
        "--cutoff",
        dest="cutoff_hz",
        type=float,
        metavar="HZ",
        help="band limit of torque and features (default: chosen from the data)",
    )
    model = sub.add_argument_group("model")
    known = ", ".join(effects())
    model.add_argument("--effects", metavar="EFFECT", help=f"{effects_words}; known: {known}", **many)
    model.add_argument("--exclude", metavar="EFFECT", help="effects not to use", **many)
    model.add_argument("--trust", metavar="LINK", help="links whose inertia is not re-fitted", **many)
    model.add_argument("--seed", type=int, metavar="N", help="of the choice of blocks kept back (default: 0)")
    sub.add_argument(
        "--config",
        type=Path,
        metavar="YAML",
        help="file with any of these options, e.g. 'cutoff: 5'; those given on the command line win",
    )


def _settings(options: argparse.Namespace) -> dict[str, Any]:
    """Return the options that were given: those of the configuration file, then those of the command line."""
    chosen = _read_config(options.config) if options.config else {}
    given = {name: value for name, value in vars(options).items() if name in Settings.names() and value is not None}
    return chosen | given


def _read_config(path: Path) -> dict[str, Any]:
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise OptionError(f"{path}: is not YAML in UTF-8 ({error})") from None
    except OSError as error:
        raise OptionError(f"{path}: cannot be read ({error.strerror}); check --config") from None
    if not isinstance(content, dict):
        raise OptionError(f"{path}: expected 'option: value' lines, e.g. 'cutoff: 5'")
    chosen = {str(key).replace("-", "_"): value for key, value in content.items()}
    if "cutoff" in chosen:
        chosen["cutoff_hz"] = chosen.pop("cutoff")
    Settings.from_mapping(chosen, str(path))
    return chosen


def _identify(options: argparse.Namespace) -> None:
    settings = _settings(options)
    with _progress() as progress:
        result = identify(options.robot, options.recordings, progress=progress, **settings)
    _print_fits(result)
    _write(result, options.output)


def _diagnose(options: argparse.Namespace) -> None:
    settings = _settings(options)
    with _progress() as progress:
        result = diagnose(options.robot, options.recordings, progress=progress, **settings)
    _print_diagnosis(result)
    _write(result, options.output)


def _demo(options: argparse.Namespace) -> None:
    with as_file(files("torchrbd") / "demo") as case, _progress() as progress:
        result = diagnose(
            case / "arm.urdf", case / "fit.parquet", holdout=[case / "holdout.parquet"], progress=progress
        )
    _print_diagnosis(result)
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


def _print_diagnosis(result: Diagnosis) -> None:
    out = Console(highlight=False)
    out.print(f"{result.verdict.replace('_', ' ')}:", style="bold", end=" ")
    out.print(result.statement, markup=False)
    if result.findings:
        table = Table("joint", "missing", "95 % interval", "probability")
        for f in result.findings:
            values = "\n".join(f"{name.replace('_', ' ')} {interval(q)}" for name, q in f.parameters.items())
            table.add_row(", ".join(f.joints), words_of(f.effect), values, percent(f.probability))
        out.print(table)
    for rest in result.unexplained:
        out.print(rest.statement, markup=False)
    _print_fits(result.identification)


def _print_fits(result: Identification) -> None:
    out = Console(highlight=False)
    out.print(f"Unpredicted part of the torque variance on held-out data ({result.held_out}),", markup=False)
    out.print(f"torque and features band-limited at {result.cutoff_hz:.3g} Hz:")
    table = Table("joint")
    for name in result.fits:
        table.add_column(_MODEL_WORDS[name], justify="right")
    for joint in result.fits["urdf"].nmse:
        table.add_row(joint, *(number(fit.nmse[joint]) for fit in result.fits.values()))
    table.add_row("mean", *(number(fit.mean_nmse) for fit in result.fits.values()), style="bold")
    out.print(table)
    for note in result.notes:
        out.print(f"note: {note}", markup=False)


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
