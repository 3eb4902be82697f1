"""``torchrbd stats``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from torchrbd.cli.parameters import Config, Folder, Quiet, Recordings, Robot, examples, value, with_options

OPTIONS = (
    "time", "joints", "effects", "exclude", "gravity", "payload", "mapping", "cutoff_hz", "encoder_noise",
)  # fmt: skip
AFTER = "\n\n".join(
    (
        examples(
            "torchrbd stats arm.urdf day/*.csv --cutoff 5 -o moments",
            "torchrbd stats arm.urdf day/*.csv --cutoff 5 -o all --merge day.stats",
            "torchrun --nproc-per-node 2 -m torchrbd stats arm.urdf *.csv --cutoff 5 -o o",
        ),
        """\
DIR/<recording>.stats holds second moments, what the recording is (name, size,
SHA-256), and all that the moments depend on: kinematics and gravity of the
robot, cut-off, options, format. --cutoff is required: the same for all that
are used together. From them,
  torchrbd identify ROBOT.urdf DIR/*.stats -o OUT
gives, to rounding, what
  torchrbd identify ROBOT.urdf RECORDING... --estimator moments --cutoff HZ
gives. Clocks, sticking, units and position noise are not looked into. Effects
whose shape is sought in a recording's range (Stribeck's friction, ripple,
stops) are refused. 'diagnose' needs the recordings. Files that are there and
up to date are not made again. Several processes that torchrun starts share
the work, on one machine or on more that share the folders.""",
    )
)


@with_options(OPTIONS)
def stats(
    robot: Robot,
    recordings: Recordings,
    /,
    *,
    output: Folder,
    merge: Annotated[Path | None, value("FILE", "write the sum of all recordings, too")] = None,
    quiet: Quiet = False,
    config: Config = None,
    **options: Any,
) -> None:
    """Stream recordings into second moments, a small file each, for identify in place of them."""
    from torchrbd.cli.config import chosen
    from torchrbd.cli.statistics import stats as work

    work(robot, recordings, output, merge, chosen(config, options, OPTIONS), quiet)
