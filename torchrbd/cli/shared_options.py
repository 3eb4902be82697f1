"""Options that several commands share."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

RECORDING = (
    "CSV, Parquet, NPZ or MATLAB file with columns t [s], q_<joint> [rad, m], tau_<joint> [N m, N], optionally "
    "qd_<joint>, q_ref_<joint>, q_link_<joint> (encoder behind the gear), temperature_<joint> [degC]; or a ROS bag, an "
    "MCAP file or a LeRobot data set; 'identify' takes .stats files of 'torchrbd stats', too"
)
_MANY: dict[str, Any] = {"nargs": "+", "action": "extend"}


def add_shared(sub: argparse.ArgumentParser, effects_words: str, *, output_required: bool = True) -> None:
    """Add what commands understand that fit a robot to recordings."""
    add_robot(sub, output_required=output_required)
    data = sub.add_argument_group("data")
    data.add_argument("--holdout", type=Path, metavar="FILE", help="recordings that no fit sees", **_MANY)
    data.add_argument(
        "--holdout-fraction", type=float, metavar="X", help="else, the part of each recording kept back (default: 0.25)"
    )
    add_reading(data)
    model = sub.add_argument_group("model")
    add_model(model, effects_words)
    model.add_argument("--trust", metavar="LINK", help="links whose inertia is not re-fitted", **_MANY)
    model.add_argument("--seed", type=int, metavar="N", help="of the choice of blocks kept back (default: 0)")
    model.add_argument(
        "--time-limit",
        metavar="SECONDS",
        help="end the search after so long (60, 90s, 2min) with the best model so far, marked as unfinished; so does "
        "the first Ctrl-C (default: none)",
    )
    add_config(sub)


def add_robot(sub: argparse.ArgumentParser, *, output_required: bool = True) -> None:
    """Add robot, recordings and the folder for results."""
    sub.add_argument("robot", type=Path, metavar="ROBOT.urdf", help="what the simulator believes: URDF, or MJCF")
    sub.add_argument(
        "recordings",
        nargs="+",
        type=Path,
        metavar="RECORDING",
        help=RECORDING,
    )
    sub.add_argument(
        "-o", "--output", type=Path, required=output_required, metavar="DIR", help="folder for the results"
    )


def add_reading(data: argparse._ArgumentGroup, cutoff: str = "default: chosen from the data") -> None:
    """Add how recordings are read; ``cutoff`` says what the band limit is if it is not given."""
    data.add_argument("--time", metavar="A:B", help="use only these seconds of each recording")
    data.add_argument("--joints", metavar="JOINT", help="joints whose torque counts (default: all)", **_MANY)
    data.add_argument(
        "--payload",
        metavar="FILE=kg,x,y,z[@LINK]",
        help="known load in a recording: mass and centre [kg, m] on a link (default: a chain's last)",
        **_MANY,
    )
    data.add_argument(
        "--mapping", type=Path, metavar="YAML", help="other column names, units, signs, gear ratios, torque constants"
    )
    data.add_argument(
        "--cutoff",
        dest="cutoff_hz",
        type=float,
        metavar="HZ",
        help=f"band limit of torque and features ({cutoff})",
    )
    data.add_argument(
        "--encoder-noise",
        metavar="X",
        help="standard deviation of the positions [rad, m], one number or JOINT=number (default: estimated)",
        **_MANY,
    )


def add_model(model: argparse._ArgumentGroup, effects_words: str) -> None:
    """Add gravity, and which effects stand beside the rigid body."""
    model.add_argument(
        "--gravity",
        nargs=3,
        type=float,
        metavar=("X", "Y", "Z"),
        help="in the base's axes [m/s^2], e.g. 0 9.81 0 on a wall (default: 0 0 -9.81)",
    )
    place = "PLACE is a joint, a pair JOINT_OTHER or a link; @RECORDING=FROM:TO [s] after it for what acts for a time"
    model.add_argument(
        "--effects", metavar="EFFECT[@PLACE]", help=f"{effects_words}; {place}; 'torchrbd effects' lists them", **_MANY
    )
    model.add_argument("--exclude", metavar="EFFECT", help="effects not to use", **_MANY)


def add_config(sub: argparse.ArgumentParser) -> None:
    """Add the file that holds options."""
    sub.add_argument(
        "--config",
        type=Path,
        metavar="YAML",
        help="file with any of these options, e.g. 'cutoff: 5'; those given on the command line win; files that it "
        "names are sought from its folder",
    )
