"""``torchrbd compare-estimators``."""

from __future__ import annotations

from functools import partial
from typing import Annotated, Any

from torchrbd.cli.estimators import list_of
from torchrbd.cli.parameters import Config, FolderIfAny, Quiet, Recordings, Robot, examples, values, with_options
from torchrbd.estimators import COMPARABLE
from torchrbd.options import Options

AFTER = "\n\n".join(
    (
        examples(
            "torchrbd compare-estimators arm.urdf monday.csv",
            "torchrbd compare-estimators arm.urdf a.csv --estimators wls iv smoother",
        ),
        list_of(COMPARABLE),
    )
)
OPTIONS = tuple(name for name in Options.names() if name != "estimator")


@with_options(OPTIONS)
def compare_estimators(
    robot: Robot,
    recordings: Recordings,
    /,
    *,
    output: FolderIfAny = None,
    estimators: Annotated[
        list[str] | None,
        values(
            "NAME",
            "those to compare, see below (default: all); auto, the default of identify, is smoother where position "
            "noise matters and physical where not",
        ),
    ] = None,
    quiet: Quiet = False,
    config: Config = None,
    **options: Any,
) -> None:
    """Estimate the parameters with many methods and judge each on held-out data."""
    from torchrbd.cli.config import chosen
    from torchrbd.cli.running import run
    from torchrbd.cli.tables import print_comparison
    from torchrbd.inference import compare_estimators as compared

    work = partial(compared, estimators=estimators or COMPARABLE)
    run(work, print_comparison, robot, recordings, output, chosen(config, options, OPTIONS), quiet=quiet)
