"""Read a robot in any supported format."""

from __future__ import annotations

from pathlib import Path

from torchrbd.robot.description import Description
from torchrbd.robot.urdf import read_urdf
from torchrbd.robot.xml_files import load, parse


def read_robot(source: str | Path | bytes) -> Description:
    """Read a robot from a URDF or MJCF file, or from the text of one.

    Args:
        source: a path, or the text itself.

    Raises:
        RobotError: the file cannot be used.
        OptionError: it is MJCF, and MuJoCo is not installed.
    """
    where, text = load(source)
    root = parse(where, text)
    if root.tag != "mujoco":
        return read_urdf(where, text, root)
    from torchrbd.robot.mjcf import read_mjcf  # MuJoCo is an extra

    return read_mjcf("MJCF text" if where == "URDF text" else where, root)
