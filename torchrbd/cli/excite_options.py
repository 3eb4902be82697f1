"""What ``torchrbd excite`` understands."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any


def add_excite(sub: argparse.ArgumentParser) -> None:
    """Give a parser the options of the command."""
    words: dict[str, Any] = {"nargs": "+", "action": "extend", "default": []}
    sub.add_argument("robot", type=Path, metavar="ROBOT.urdf", help="the robot, with the limits that hold")
    sub.add_argument(
        "-d",
        "--diagnosis",
        type=Path,
        metavar="DIR",
        help="folder that 'diagnose -o' wrote: separate what it could not tell apart (default: tell the parameters)",
    )
    sub.add_argument(
        "-o", "--output", type=Path, required=True, metavar="CSV", help="t, q_, qd_, qdd_ of each joint; YAML beside it"
    )
    motion = sub.add_argument_group("motion")
    motion.add_argument(
        "--frequency", dest="frequency_hz", type=float, metavar="HZ", help="one over a period (default: 0.1)"
    )
    motion.add_argument("--harmonics", type=int, metavar="N", help="of the frequency in the motion (default: 5)")
    motion.add_argument("--periods", type=int, metavar="N", help="to record (default: 3)")
    motion.add_argument(
        "--rate", dest="rate_hz", type=float, default=100.0, metavar="HZ", help="of the samples (default: 100)"
    )
    motion.add_argument("--joints", nargs="+", action="extend", metavar="JOINT", help="that move (default: all)")
    motion.add_argument("--starts", type=int, metavar="N", help="of the optimiser (default: 4)")
    motion.add_argument("--seed", type=int, metavar="N", help="of these starts (default: 0)")
    motion.add_argument(
        "--gravity", type=float, nargs=3, metavar=("X", "Y", "Z"), help="in the base's axes (default: 0 0 -9.81)"
    )
    limits = sub.add_argument_group("limits")
    limits.add_argument("--speed", type=float, metavar="X", help="share of the speed limits to use (default: 1)")
    limits.add_argument("--margin", type=float, metavar="X", help="part of every limit left free (default: 0.1)")
    limits.add_argument(
        "--range", dest="ranges", metavar="JOINT=LOW:HIGH", help="in place of the URDF's; LOW = HIGH holds it", **words
    )
    limits.add_argument("--velocity", dest="velocities", metavar="JOINT=V", help="in place of the URDF's", **words)
    limits.add_argument("--effort", dest="efforts", metavar="JOINT=TAU", help="in place of the URDF's", **words)
    limits.add_argument(
        "--box",
        metavar="AXIS=LOW:HIGH",
        help="where the origins of all links stay [m], base's axes, e.g. z=0.05: x=-0.5:0.7",
        **words,
    )
