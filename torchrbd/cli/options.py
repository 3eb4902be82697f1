"""What the command line understands."""

from __future__ import annotations

import argparse
import textwrap
from collections.abc import Iterable
from pathlib import Path
from typing import NoReturn

from rich_argparse import RawDescriptionRichHelpFormatter

from torchrbd import __version__
from torchrbd.cli.excite_options import add_excite
from torchrbd.cli.fleet_options import add_fleet, add_merge, add_stats
from torchrbd.cli.shared_options import RECORDING, add_shared
from torchrbd.estimators import COMPARABLE, ESTIMATORS, WITH_INTERVALS

_FITTED_EFFECTS = "effects to fit beside the inertial parameters, at every joint or only at PLACE (default: {})"
# Commands that say how far they are.
_LONG = ("identify", "diagnose", "compare-estimators", "demo", "excite", "simulate", "stats", "fleet")
_FRICTION = "viscous and Coulomb friction; exclude both for the rigid body alone"


class _Help(RawDescriptionRichHelpFormatter):
    """Help in colours, in which [m] is a unit and the list of estimators keeps its lines."""

    help_markup = text_markup = False


class _Parser(argparse.ArgumentParser):
    """Says what to do where an option with several values has taken the files that stand after it."""

    def error(self, message: str) -> NoReturn:
        if "ROBOT.urdf" in message or "RECORDING" in message:
            message += "; give ROBOT.urdf RECORDING... first, options that take several values take all that follows"
        super().error(message)


def parser() -> argparse.ArgumentParser:
    """Build the parser of all commands; the one that was chosen is ``command``, and ``output`` None if not given."""
    top = _Parser(
        "torchrbd",
        description="Find, name and model the physics that a robot's URDF leaves out.",
        formatter_class=_Help,
    )
    top.add_argument("--version", action="version", version=f"torchrbd {__version__}")
    commands = top.add_subparsers(required=True, metavar="COMMAND")

    def command(name: str, words: str) -> argparse.ArgumentParser:
        sub = commands.add_parser(name, help=words, description=words, formatter_class=_Help)
        sub.set_defaults(command=name, output=None)
        if name in _LONG:
            sub.add_argument("-q", "--quiet", action="store_true", help="do not say on stderr how far the work is")
        return sub

    sub = command("identify", "Fit the inertial parameters of a URDF to recordings; always physically valid.")
    add_shared(sub, _FITTED_EFFECTS.format(_FRICTION))
    sub.add_argument("--estimator", metavar="NAME", help="how parameters are found, see below (default: auto)")
    sub.add_argument(
        "--each",
        action="store_true",
        help="identify each RECORDING on its own, into DIR/<its name without ending>, instead of one robot from all; "
        "one that cannot be used does not stop the others",
    )
    sub.add_argument("-j", "--jobs", type=int, metavar="N", help="processes that work on --each (default: one a core)")
    sub.epilog = _list_of(ESTIMATORS)
    sub = command("diagnose", "Find, name and model what the URDF leaves out.")
    add_shared(sub, "effects that the search may use (default: all)")
    sub.add_argument(
        "--simulated",
        nargs="+",
        action="extend",
        type=Path,
        metavar="SIM",
        help="recordings of a simulator with the same commands, one for each RECORDING and then for each --holdout, in "
        "their order: what differs from the simulation is located and named, in place of what differs from the URDF. "
        "Where the simulator has other inertials than the URDF, the difference shows up as inertial parameters",
    )
    sub = command("compare", "Say what changed between two diagnoses of one robot, and how certain that is.")
    _add_compare(sub)
    sub = command(
        "compare-estimators",
        "Estimate the parameters with many methods and judge each on held-out data.",
    )
    add_shared(sub, _FITTED_EFFECTS.format("none"), output_required=False)
    sub.add_argument(
        "--estimators",
        nargs="+",
        default=COMPARABLE,
        metavar="NAME",
        help="those to compare, see below (default: all); auto, the default of identify, is smoother where position "
        "noise matters and physical where not",
    )
    sub.epilog = _list_of(COMPARABLE)
    sub = command("export", "Write a fitted model as a file for a simulator, and say what that file cannot hold.")
    _add_export(sub)
    sub = command("simulate", "Roll a model forward from a recorded state under the recorded torque; write the motion.")
    _add_simulate(sub)
    sub = command("excite", "Design the motion to record next: within limits, from rest to rest.")
    add_excite(sub)
    sub = command("inspect", "Say what a recording holds and what looks wrong; write a mapping to edit.")
    _add_inspect(sub)
    sub = command("stats", "Stream recordings into second moments, a small file each, for identify in place of them.")
    add_stats(sub)
    sub = command("merge", "Add statistics files: one file in place of many.")
    add_merge(sub)
    sub = command("fleet", "Identify many robots, say who differs from its sisters, and what changed.")
    add_fleet(sub)
    command("effects", "List the effects that can be missing: their names, what they are, and their torque.")
    sub = command("demo", "Diagnose a bundled case: a six-joint arm with a friction that its URDF does not hold.")
    sub.add_argument(
        "-o", "--output", type=Path, default=Path("torchrbd-demo"), metavar="DIR", help="(default: %(default)s)"
    )
    return top


def _add_compare(sub: argparse.ArgumentParser) -> None:
    for name, words in (("before", "the first"), ("after", "the second")):
        sub.add_argument(
            name,
            type=Path,
            metavar=name.upper(),
            help=f"folder that 'diagnose -o' wrote, or its diagnosis.json: {words}",
        )
    sub.add_argument("-o", "--output", type=Path, metavar="DIR", help="folder for comparison.json and comparison.html")


def _add_inspect(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("file", type=Path, metavar="FILE", help=RECORDING)
    sub.add_argument(
        "robot", type=Path, nargs="?", metavar="ROBOT.urdf", help="whose joints and limits count (default: as named)"
    )
    sub.add_argument("--mapping", type=Path, metavar="YAML", help="column names and units as far as they are known")
    sub.add_argument(
        "-o", "--output", type=Path, metavar="YAML", help="mapping to write, with what was found and guessed"
    )


def _add_export(sub: argparse.ArgumentParser) -> None:
    sub.add_argument(
        "model", type=Path, metavar="MODEL", help="model.safetensors, or the folder that 'identify' or 'diagnose' wrote"
    )
    sub.add_argument("--to", choices=("urdf", "mjcf"), required=True, help="format; mjcf is MuJoCo's own")
    sub.add_argument(
        "-o", "--output", dest="file", type=Path, metavar="FILE", help="(default: model.urdf or model.xml beside MODEL)"
    )
    sub.add_argument(
        "--check",
        nargs="+",
        action="extend",
        default=[],
        type=Path,
        metavar="RECORDING",
        help="compare the torques of the file in MuJoCo with the model's on the motion of these recordings",
    )
    sub.add_argument("--mapping", type=Path, metavar="YAML", help="column names and units of these recordings")
    sub.add_argument(
        "--cutoff",
        dest="cutoff_hz",
        type=float,
        metavar="HZ",
        help="band limit of their motion (default: chosen from the data)",
    )


def _add_simulate(sub: argparse.ArgumentParser) -> None:
    sub.add_argument(
        "model",
        type=Path,
        metavar="MODEL",
        help="ROBOT.urdf (or MJCF), model.safetensors, or the folder that 'identify' or 'diagnose' wrote",
    )
    sub.add_argument("recording", type=Path, metavar="RECORDING", help=RECORDING)
    sub.add_argument(
        "-o",
        "--output",
        dest="file",
        type=Path,
        required=True,
        metavar="FILE",
        help=".parquet, .csv or .npz with t, q_<joint>, qd_<joint>, tau_<joint>, which the other commands read",
    )
    sub.add_argument(
        "--from", dest="start", type=float, default=0.0, metavar="S", help="seconds of the recording (default: 0)"
    )
    sub.add_argument("--seconds", type=float, metavar="S", help="how long (default: to the end, or to the next gap)")
    sub.add_argument("--rate", type=float, metavar="HZ", help="samples a second (default: the recording's)")
    sub.add_argument("--mapping", type=Path, metavar="YAML", help="column names and units of the recording")
    sub.add_argument(
        "--cutoff",
        dest="cutoff_hz",
        type=float,
        metavar="HZ",
        help="band limit of the recorded motion (default: chosen from the data)",
    )
    sub.add_argument(
        "--gravity", nargs=3, type=float, metavar=("X", "Y", "Z"), help="of a URDF [m/s^2] (default: 0 0 -9.81)"
    )
    sub.epilog = (
        "Nothing holds the motion to the recorded one, so that errors grow with time. Joints without a\n"
        "recorded torque move as recorded. Joint limits and contacts are left out."
    )


def _list_of(estimators: Iterable[str]) -> str:
    margin = " " * 15
    lines = (textwrap.fill(f"  {name:<13}{ESTIMATORS[name]}", 78, subsequent_indent=margin) for name in estimators)
    rest = (
        f"Only {', '.join(WITH_INTERVALS)} come with intervals. The others' parameters may be unphysical; the nearest "
        "physical ones are then taken."
    )
    return "\n".join(("Estimators:", *lines, textwrap.fill(rest, 78)))
