"""``torchrbd demo``."""

from __future__ import annotations

from importlib.resources import as_file, files
from pathlib import Path
from typing import Annotated

from torchrbd.cli.parameters import Quiet, examples, value

AFTER = examples("torchrbd demo", "torchrbd demo -o out")
_OUTPUT = Path("torchrbd-demo")


def demo(
    *,
    output: Annotated[Path, value("DIR", "folder for the results", short="o", default=_OUTPUT)] = _OUTPUT,
    quiet: Quiet = False,
) -> None:
    """Diagnose a bundled case: a six-joint arm with a friction that its URDF does not hold."""
    from torchrbd.cli.running import run
    from torchrbd.cli.tables import print_diagnosis
    from torchrbd.diagnosis import diagnose

    with as_file(files("torchrbd") / "demo") as case:
        held_out = {"holdout": case / "holdout.parquet"}
        run(diagnose, print_diagnosis, case / "arm.urdf", [case / "fit.parquet"], output, held_out, quiet=quiet)
