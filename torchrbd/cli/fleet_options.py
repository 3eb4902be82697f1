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
units and position noise are not looked into; 'diagnose' needs the recordings. Files that are there and up to date are
not made again. Several processes, on one machine or on more that share the folders:
  torchrun --nproc-per-node 2 -m torchrbd stats ROBOT.urdf RECORDING... --cutoff HZ -o DIR"""


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
