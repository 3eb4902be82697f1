"""What ``torchrbd simulate`` does: roll a model forward, write the motion as a recording."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from torchrbd._runtime.outputs import check_file
from torchrbd.cli.progress import progress_bar
from torchrbd.errors import OptionError
from torchrbd.model import RigidBodyDynamics
from torchrbd.report.text.console import AS_RECORDED, simulated_words, wrote
from torchrbd.report.text.numbers import number
from torchrbd.simulation import SimulatedMotion, check_suffix, simulate


def simulate_recording(
    given: Path, recording: Path, file: Path, *, gravity: Sequence[float] | None, quiet: bool, **options: Any
) -> None:
    """Simulate, print how far the motion is from the recorded one, and write it.

    Args:
        given: a model, or a robot.
        recording: whose torque moves it.
        file: for the motion.
        gravity: of a robot [m/s^2].
        quiet: do not say how far the work is.
        **options: of ``simulate``.

    Raises:
        InputError: a model, recording or option that cannot be used.
    """
    check_suffix(file)
    check_file(file)
    if file.exists() and recording.exists() and file.samefile(recording):
        raise OptionError(f"output '{file}' is the recording; name another file for the motion")
    model = _model(given, gravity)
    with progress_bar(quiet=quiet) as progress:
        found = simulate(model, recording, progress=progress, **options)
    found.write(file)
    _print(found, model, file)


def _model(given: Path, gravity: Sequence[float] | None) -> RigidBodyDynamics:
    """Return the model of a result, or a robot with the friction that its description has."""
    if given.is_dir() or given.suffix == ".safetensors":
        if gravity is not None:
            raise OptionError(f"--gravity is of a URDF; {given} has its own")
        return RigidBodyDynamics.load(given)
    return RigidBodyDynamics.from_urdf(given, gravity=gravity)


def _print(found: SimulatedMotion, model: RigidBodyDynamics, file: Path) -> None:
    out = Console(highlight=False)
    out.print(simulated_words(found.t[0], found.t[-1]), markup=False)
    tracking = found.tracking
    table = Table("joint", "distance", *(["tracking error", "simulated"] if tracking else []))
    sliding = dict(zip(model.robot.joint_names, model.robot.prismatic.tolist(), strict=True))
    for joint, distance in found.distance.items():
        symbol = "m" if sliding[joint] else "rad"
        more = (f"{number(x)} {symbol}" for x in tracking.get(joint, ()))
        words = f"{number(distance)} {symbol}" if distance == distance else "lost"
        table.add_row(Text(joint), AS_RECORDED if joint in found.moved else words, *more)
    out.print(table)
    for note in found.notes:
        out.print(f"note: {note}", markup=False)
    out.print(wrote(file), markup=False, soft_wrap=True)
