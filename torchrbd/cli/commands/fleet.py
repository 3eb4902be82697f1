"""``torchrbd fleet``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from torchrbd.cli.parameters import Folder, Quiet, examples, file, value

AFTER = "\n\n".join(
    (
        examples(
            "torchrbd fleet robots.yaml -o june",
            "torchrbd fleet robots.yaml -o july --before june -j 8",
        ),
        """\
ROBOTS.yaml, files from its folder ('torchrbd schema robots' has its keys):
  options: {cutoff: 5}            # of 'torchrbd identify', for all; optional
  robots:
    - name: cell-1
      urdf: arm.urdf
      recordings: [cell-1/monday.parquet, cell-1/tuesday.parquet]
      mapping: driver.yaml       # optional, as are options of this robot alone
DIR/<name> holds what 'identify' writes, without its report; DIR/fleet.html and
fleet.json report who differs from its sisters, robots with the same
kinematics, and what changed. What is there, made from the same files and
options, is not identified again. After Ctrl-C the same call goes on.""",
    )
)


def fleet(
    robots: Annotated[Path, file("ROBOTS.yaml", "list of robots, see below")],
    /,
    *,
    output: Folder,
    before: Annotated[
        Path | None, value("DIR", "results of the same fleet at an earlier time: report what changed")
    ] = None,
    engine: Annotated[
        Literal["local", "dask"],
        value("ENGINE", "processes of this machine, or a Dask cluster: pip install 'torchrbd[fleet]'", default="local"),
    ] = "local",
    scheduler: Annotated[str | None, value("ADDRESS", "of a Dask cluster", default="processes of this machine")] = None,
    jobs: Annotated[int | None, value("N", "processes on this machine", short="j", default="one for each core")] = None,
    retries: Annotated[int, value("N", "of a robot whose process has died", default=2)] = 2,
    quiet: Quiet = False,
) -> None:
    """Identify many robots, report who differs from its sisters, and what changed."""
    from torchrbd._runtime.engines import Engine
    from torchrbd.cli.fleet import fleet as work

    work(robots, output, before, Engine(engine, jobs, scheduler, retries), quiet)
