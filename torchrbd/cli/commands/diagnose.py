"""``torchrbd diagnose``."""

from __future__ import annotations

from typing import Annotated, Any

from torchrbd.cli.parameters import Config, Folder, Quiet, Recordings, Robot, examples, value, with_options

AFTER = examples(
    "torchrbd diagnose arm.urdf monday.csv -o out",
    "torchrbd diagnose arm.urdf real.csv --simulated simulator.csv -o out",
    "torchrbd diagnose arm.urdf a.csv b.csv --holdout c.csv --cutoff 5 -o out",
    "torchrbd diagnose arm.urdf real.csv --mapping driver.yaml -o out",
    "torchrbd diagnose arm.urdf monday.csv --stability 20 -o out",
)
_STABILITY = (
    "repeat the search so many times with blocks of time that are weighted at random (a bootstrap), and report the "
    "share of repetitions that find each finding again; one takes about as long as the search; not in a --config file"
)


@with_options()
def diagnose(
    robot: Robot,
    recordings: Recordings,
    /,
    *,
    output: Folder,
    quiet: Quiet = False,
    config: Config = None,
    stability: Annotated[int | None, value("N", _STABILITY, group="Model", default=0)] = None,
    **options: Any,
) -> None:
    """Find, name and model the physics that a URDF leaves out."""
    from torchrbd.cli.config import chosen
    from torchrbd.cli.running import run
    from torchrbd.cli.tables import print_diagnosis
    from torchrbd.diagnosis import diagnose as work

    given = chosen(config, options) | ({} if stability is None else {"stability": stability})
    run(work, print_diagnosis, robot, recordings, output, given, quiet=quiet)
