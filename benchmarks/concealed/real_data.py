"""Real recordings as effects are hidden in them: which ones, and the smoothed motion along which torque is added."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import pinocchio as pin
from pyarrow import csv
from scipy.signal import butter, sosfiltfilt

from .motion import Motion
from .robots import Robot
from .sizes import RATE_HZ

SMOOTH_HZ = 8.0


@dataclass(frozen=True)
class DataSet:
    """Recordings of one robot: files to fit and one to judge on; without it, blocks of those to fit."""

    folder: str
    urdf: str
    fit: tuple[str, ...]
    holdout: str | None = None


DATA_SETS = {
    "kuka": DataSet("kuka_kr300", "robot.urdf", ("A.csv", "B.csv"), "C.csv"),
    "double_pendulum": DataSet(
        "dfki_double_pendulum",
        "robot_A.urdf",
        ("A_20220812_061157.csv", "A_20220812_060143.csv", "A_20220812_060245.csv"),
        "A_20220812_060329.csv",
    ),
    "pendulum": DataSet("dfki_pendulum", "robot.urdf", ("energy_shaping.csv", "sac.csv"), "ilqr.csv"),
    "emps": DataSet("emps", "robot.urdf", ("train.csv",), "pulses.csv"),
    "panda": DataSet("panda", "robot.urdf", ("exciting_traj.csv",)),
}


@dataclass(frozen=True)
class RealRobot(Robot):
    """A robot with the link names of its own URDF."""

    @cached_property
    def model(self) -> pin.Model:
        """Pinocchio's model; a joint that turns on and on has one angle too."""
        return pin.buildModelFromXML(self.urdf.replace('type="continuous"', 'type="revolute"'))

    @property
    def links(self) -> tuple[str, ...]:
        """Names of the links that the joints move."""
        model = self.model
        bodies = [f for f in model.frames if f.type == pin.FrameType.BODY]
        return tuple(next(f.name for f in bodies if f.parentJoint == k) for k in range(1, model.njoints))


@dataclass(frozen=True)
class Taken:
    """A recording: its table as it is, and at RATE_HZ its smoothed motion and torque (N, n)."""

    table: Mapping[str, np.ndarray]
    motion: Motion
    torque: np.ndarray


def take(robot: Robot, path: Path, file: str) -> Taken:
    """Read a recording.

    Args:
        robot: as its URDF has it.
        path: a CSV file.
        file: the name that it will have.
    """
    read = csv.read_csv(path)
    table = {name: read[name].to_numpy().astype(float) for name in read.column_names}
    table["t"] = table["t"] - table["t"][0]
    t = np.arange(0.0, table["t"][-1], 1.0 / RATE_HZ)
    even = [np.stack([np.interp(t, table["t"], table[f"{s}_{j}"]) for j in robot.joints], 1) for s in ("q", "tau")]
    q, torque = sosfiltfilt(butter(4, SMOOTH_HZ, fs=RATE_HZ, output="sos"), even, axis=1)
    qd = np.gradient(q, t[1], axis=0)
    qdd = np.gradient(qd, t[1], axis=0)
    return Taken(table, Motion(robot, file, t, q, qd, qdd, robot.torque(q, qd, qdd), np.full_like(q, 25.0)), torque)
