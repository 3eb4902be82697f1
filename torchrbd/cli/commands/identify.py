"""``torchrbd identify``."""

from __future__ import annotations

from typing import Annotated, Any

from torchrbd.cli.estimators import list_of
from torchrbd.cli.parameters import Config, Folder, Quiet, Robot, Statistics, examples, flag, value, with_options
from torchrbd.errors import OptionError
from torchrbd.estimators import ESTIMATORS

AFTER = "\n\n".join(
    (
        examples(
            "torchrbd identify arm.urdf monday.csv -o out",
            "torchrbd identify arm.urdf a.csv b.csv --holdout c.csv --cutoff 5 -o out",
            "torchrbd identify arm.urdf day/*.csv --each -j 4 -o out",
        ),
        list_of(ESTIMATORS),
    )
)


@with_options()
def identify(
    robot: Robot,
    recordings: Statistics,
    /,
    *,
    output: Folder,
    each: Annotated[
        bool,
        flag(
            "identify each RECORDING on its own, into DIR/<its name without ending>, instead of one robot from all; "
            "one that cannot be used does not stop the others, and --time-limit is for each; Ctrl-C ends those that "
            "are begun early, and begins no other"
        ),
    ] = False,
    jobs: Annotated[
        int | None, value("N", "processes that work on --each", short="j", default="one for each core")
    ] = None,
    quiet: Quiet = False,
    config: Config = None,
    **options: Any,
) -> None:
    """Fit the inertial parameters of a URDF to recordings; the result is always physically valid."""
    from torchrbd.cli.config import chosen
    from torchrbd.cli.each import identify_each
    from torchrbd.cli.running import run
    from torchrbd.cli.tables import print_identification
    from torchrbd.inference import identify as work

    if each:
        identify_each(robot, recordings, output, chosen(config, options), jobs=jobs, quiet=quiet)
        return
    if jobs is not None:
        raise OptionError("-j is for --each, which identifies each recording on its own; add it or leave -j out")
    run(work, print_identification, robot, recordings, output, chosen(config, options), quiet=quiet)
