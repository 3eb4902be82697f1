"""Real recordings as effects are hidden in them: which ones, and the motion along which torque is added.

What a motion has beyond a low-pass filter moves masses too: torque that is added along a part of it only is no effect
that a machine could have, and a recording says so. So all of a motion counts that rises above the noise of its
positions.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import pinocchio as pin
from pyarrow import csv
from scipy.signal import butter, sosfiltfilt, welch

from .motion import Motion
from .robots import Robot
from .sizes import RATE_HZ

# Sizes are those of motions below this; positions tell motion up to where their power is so many times their noise's,
# which is what they have in the highest quarter of their frequencies.
SMOOTH_HZ, CLEAR = 8.0, 10.0
_STRETCH = 1024


@dataclass(frozen=True)
class DataSet:
    """Recordings of one robot: files to fit and one to judge on; without it, blocks of those to fit."""

    folder: str
    urdf: str
    fit: tuple[str, ...]
    holdout: str | None = None


# Other recordings of the pendulum are not used. Of energy_shaping.csv and sac.csv with --holdout ilqr.csv, torchrbd
# diagnose gives an NMSE of 0.83 for least squares with friction, and 0.50 for the URDF.
DATA_SETS = {
    "kuka": DataSet("kuka_kr300", "robot.urdf", ("A.csv", "B.csv"), "C.csv"),
    "double_pendulum": DataSet(
        "dfki_double_pendulum",
        "robot_A.urdf",
        ("A_20220812_061157.csv", "A_20220812_060143.csv", "A_20220812_060245.csv"),
        "A_20220812_060329.csv",
    ),
    "pendulum": DataSet(
        "dfki_pendulum", "robot.urdf", ("fft_swing_100s.csv", "ddp.csv"), "pd_system_identification.csv"
    ),
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
    """A recording: its table as it is, its motion and torque (N, n) at RATE_HZ below SMOOTH_HZ, and all that moved.

    Attributes:
        table: columns of the file.
        motion: smooth, as sizes are measured on it.
        torque: the same.
        moved: at the recording's own rate, with all that rises above noise.
    """

    table: Mapping[str, np.ndarray]
    motion: Motion
    torque: np.ndarray
    moved: Motion


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
    q, torque = (_smooth(_even(robot, table, signal, t), [SMOOTH_HZ] * robot.n, RATE_HZ) for signal in ("q", "tau"))
    dt = float(np.median(np.diff(table["t"])))
    fine = np.arange(0.0, table["t"][-1], dt)
    q_fine = _even(robot, table, "q", fine)
    moved = _smooth(q_fine, told_hz(q_fine, dt), 1.0 / dt)
    return Taken(table, _motion(robot, file, t, q), torque, _motion(robot, file, fine, moved))


def told_hz(q: np.ndarray, dt: float) -> list[float]:
    """Return up to which frequency [Hz] positions (N, n) tell each joint's motion, SMOOTH_HZ or more."""
    hz, power = welch(np.diff(q, 2, axis=0), 1.0 / dt, nperseg=min(_STRETCH, len(q) - 2), axis=0)
    # Differences make a steep spectrum flat; their gain is divided out. The mean and what is next to it is no motion.
    hz, power = hz[2:], power[2:] / (2.0 * np.sin(np.pi * hz[2:] * dt))[:, None] ** 4
    noise = np.median(power[hz > 0.75 * hz[-1]], axis=0)
    lost = power < CLEAR * noise
    first = np.where(lost.any(0), lost.argmax(0), len(hz) - 1)
    return np.maximum(SMOOTH_HZ, hz[first]).tolist()


def _even(robot: Robot, table: Mapping[str, np.ndarray], signal: str, t: np.ndarray) -> np.ndarray:
    return np.stack([np.interp(t, table["t"], table[f"{signal}_{joint}"]) for joint in robot.joints], 1)


def _smooth(x: np.ndarray, cutoff_hz: Sequence[float], rate_hz: float) -> np.ndarray:
    """Return signals (N, n), each below its cutoff, without lag."""
    each = zip(x.T, cutoff_hz, strict=True)
    # A filter next to half the rate does nothing.
    every = [y if 2.2 * hz > rate_hz else sosfiltfilt(butter(4, hz, fs=rate_hz, output="sos"), y) for y, hz in each]
    return np.stack(every, axis=1)


def _motion(robot: Robot, file: str, t: np.ndarray, q: np.ndarray) -> Motion:
    qd = np.gradient(q, t[1], axis=0)
    qdd = np.gradient(qd, t[1], axis=0)
    return Motion(robot, file, t, q, qd, qdd, robot.torque(q, qd, qdd), np.full_like(q, 25.0))
