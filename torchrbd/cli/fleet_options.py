"""What the commands for much data and for many robots understand."""

from __future__ import annotations

import argparse
from pathlib import Path

from torchrbd.cli.shared_options import add_config, add_model, add_reading, add_robot

_STATS = """\
DIR/<recording>.stats holds second moments, what the recording is (name, size, SHA-256), and all that the moments depend
on: kinematics and gravity of the robot, cut-off, options, version. From them,
  torchrbd identify ROBOT.urdf DIR/*.stats -o OUT
gives, to rounding, what 'identify ROBOT.urdf RECORDING... --estimator moments --cutoff HZ' gives. Clocks, sticking,
units and position noise are not looked into; effects whose shape is sought in a recording's range (Stribeck's friction,
ripple, stops) are refused; 'diagnose' needs the recordings. Files that are there and up to date are not made again.
Several processes, on one machine or on more that share the folders:
  torchrun --nproc-per-node 2 -m torchrbd stats ROBOT.urdf RECORDING... --cutoff HZ -o DIR"""


_FLEET = """\
ROBOTS.yaml, files sought from its folder:
  options: {cutoff: 5}            # of 'torchrbd identify', for all; optional
  robots:
    - name: cell-1
      urdf: arm.urdf
      recordings: [cell-1/monday.parquet, cell-1/tuesday.parquet]
      mapping: driver.yaml        # optional, as are options of this robot alone
DIR/<name> holds what 'identify' writes, without its report; DIR/fleet.html and fleet.json say who differs from its
sisters, robots with the same kinematics, and what changed. What is there, made from the same files and options, is not
identified again."""


def add_stats(sub: argparse.ArgumentParser) -> None:
    """Add what ``stats`` understands."""
    add_robot(sub)
    sub.add_argument("--merge", type=Path, metavar="FILE", help="write the sum of all recordings, too")
    add_reading(sub.add_argument_group("data"), "required: the same for all that are to be used together")
    model = sub.add_argument_group("model")
    add_model(model, "effects to have columns beside the inertial parameters (default: viscous and Coulomb friction)")
    add_config(sub)
    sub.epilog = _STATS


def add_merge(sub: argparse.ArgumentParser) -> None:
    """Add what ``merge`` understands."""
    sub.add_argument("files", nargs="+", type=Path, metavar="STATS", help="files that 'torchrbd stats' wrote")
    sub.add_argument("-o", "--output", type=Path, required=True, metavar="FILE", help="file to write, ending in .stats")


def add_fleet(sub: argparse.ArgumentParser) -> None:
    """Add what ``fleet`` understands."""
    sub.add_argument("robots", type=Path, metavar="ROBOTS.yaml", help="list of robots, see below")
    sub.add_argument("-o", "--output", type=Path, required=True, metavar="DIR", help="folder for the results")
    sub.add_argument(
        "--before", type=Path, metavar="DIR", help="results of the same fleet at an earlier time: say what changed"
    )
    sub.add_argument(
        "--engine",
        choices=("local", "dask"),
        default="local",
        help="processes of this machine, or a Dask cluster: pip install 'torchrbd[fleet]' (default: %(default)s)",
    )
    sub.add_argument("--scheduler", metavar="ADDRESS", help="of a Dask cluster (default: processes of this machine)")
    sub.add_argument("-j", "--jobs", type=int, metavar="N", help="processes on this machine (default: one a core)")
    sub.add_argument(
        "--retries", type=int, default=2, metavar="N", help="of a robot whose process has died (default: %(default)s)"
    )
    sub.epilog = _FLEET
