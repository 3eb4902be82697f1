"""``torchrbd diagnose``."""

from __future__ import annotations

from typing import Any

from torchrbd.cli.parameters import Config, Folder, Quiet, Recordings, Robot, examples, with_options

AFTER = examples(
    "torchrbd diagnose arm.urdf monday.csv -o out",
    "torchrbd diagnose arm.urdf real.csv --simulated simulator.csv -o out",
    "torchrbd diagnose arm.urdf a.csv b.csv --holdout c.csv --cutoff 5 -o out",
    "torchrbd diagnose arm.urdf real.csv --mapping driver.yaml -o out",
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
    **options: Any,
) -> None:
    """Find, name and model the physics that a URDF leaves out."""
    from torchrbd.cli.config import chosen
    from torchrbd.cli.running import run
    from torchrbd.cli.tables import print_diagnosis
    from torchrbd.diagnosis import diagnose as work

    run(work, print_diagnosis, robot, recordings, output, chosen(config, options), quiet=quiet)
