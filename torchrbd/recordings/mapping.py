"""Mappings: the columns and units of a recording; ``mapping_file`` reads them from YAML."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

from torchrbd.errors import RecordingError, closest
from torchrbd.recordings.drives import Drive

SIGNALS = ("q", "qd", "qdd", "tau", "q_ref", "q_link", "temperature")
ESTIMATE = "estimate"
"""In a mapping, in place of a number that ``identify`` and ``diagnose`` estimate."""
_EVERY_JOINT = "*"
_DEG = math.pi / 180
_TURN = 2 * math.pi
TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
CURRENT_UNITS = {"A": 1.0, "mA": 1e-3}
UNITS = {
    "q": {"rad": 1.0, "mrad": 1e-3, "deg": _DEG, "turn": _TURN, "m": 1.0, "mm": 1e-3},
    "qd": {"rad/s": 1.0, "deg/s": _DEG, "rpm": _TURN / 60, "turn/s": _TURN, "m/s": 1.0, "mm/s": 1e-3},
    "qdd": {"rad/s^2": 1.0, "deg/s^2": _DEG, "turn/s^2": _TURN, "m/s^2": 1.0, "mm/s^2": 1e-3},
    "tau": {"N m": 1.0, "mN m": 1e-3, "kN m": 1e3, "N mm": 1e-3, "N": 1.0, "kN": 1e3},
}
UNITS["q_ref"] = UNITS["q_link"] = UNITS["q"]
UNITS["temperature"] = {"degC": 1.0}


@dataclass(frozen=True)
class Source:
    """The column of a signal: `signal = scale * column + offset`, in SI units.

    A torque may come from a motor current. Its scale is then the torque constant times the gear ratio [N m/A, N/A].
    If the torque constant is to be estimated, ``is_known`` is False, and the scale is that for 1 N m/A.
    """

    column: str
    scale: float = 1.0
    offset: float = 0.0
    is_current: bool = False
    is_known: bool = True


@dataclass(frozen=True)
class Mapping:
    """The columns of time and of each joint's signals; signals without an entry have their default column name.

    Attributes:
        file: the mapping's file, for messages.
        time: the column of time.
        joints: joint name, or "*" for every joint, to signal (q, qd, qdd, tau, q_ref, q_link, temperature) to its
            source.
        topic: the topic of a ROS bag or of a PlotJuggler export; None for the only one with joint states.
        episodes: those of a LeRobot data set, numbered from 0; None for all.
        torque_delay_s: delay of written torques relative to the positions that they belong to [s].
        set_point_delay_s: time after which drives follow a recorded set-point [s].
        drives: joint name, or "*" for every joint, to the drive that follows its set-point; torques are computed there.
    """

    file: str = ""
    time: Source = Source("t")
    joints: dict[str, dict[str, Source]] = field(default_factory=dict)
    topic: str | None = None
    episodes: tuple[int, ...] | None = None
    torque_delay_s: float = 0.0
    set_point_delay_s: float = 0.0
    drives: dict[str, Drive] = field(default_factory=dict)

    def drive(self, joint: str) -> Drive | None:
        """Return the drive of a joint; None if its torque is recorded."""
        if joint in self.drives or "tau" in self.joints.get(joint, {}):
            return self.drives.get(joint)
        return self.drives.get(_EVERY_JOINT)

    def source(self, joint: str, index: int, signal: str) -> Source:
        """Return the source of a joint's signal; `{joint}` and `{index}` in a column's name are filled in."""
        for name in (joint, _EVERY_JOINT):
            found = self.joints.get(name, {}).get(signal)
            if found is not None:
                column = found.column.replace("{joint}", joint).replace("{index}", str(index))
                return replace(found, column=column)
        return Source(f"{signal}_{joint}")

    def named(self, joints: Sequence[str]) -> list[Source]:
        """Return the sources of single joints that have an entry: a recording must have these columns."""
        return [self.source(joint, joints.index(joint), key) for joint in joints for key in self.joints.get(joint, {})]

    def check_joints(self, joints: Sequence[str]) -> None:
        """Raise RecordingError if the mapping names a joint that the robot does not have."""
        for name in (*self.joints, *self.drives):
            if name != _EVERY_JOINT and name not in joints:
                raise RecordingError(
                    f"{self.file}: joints: the robot has no joint '{name}'{meant(name, joints)}; "
                    f"its joints are {', '.join(joints)}"
                )


def meant(name: str, known: Iterable[str]) -> str:
    """Return `closest` in brackets, after a space."""
    hint = closest(name, known)
    return f" ({hint})" if hint else ""


def chosen_topic(topics: dict[str, str], mapping: Mapping, place: str) -> str:
    """Return the topic that the mapping names, or the only one.

    Args:
        topics: description of each, by its name.
        mapping: the user's.
        place: the file, for messages.

    Raises:
        RecordingError: the mapping names an unknown topic, or none although there are several.
    """
    listed = ", ".join(f"{topic} ({words})" for topic, words in topics.items())
    if mapping.topic is None:
        if len(topics) == 1:
            return next(iter(topics))
        raise RecordingError(
            f"{place}: {len(topics)} topics of joint states: {listed}; give --mapping a file with "
            f"'topic: {next(iter(topics))}'"
        )
    if mapping.topic not in topics:
        raise RecordingError(
            f"{place}: topic: no joint states in '{mapping.topic}'{meant(mapping.topic, topics)}; there are {listed}"
        )
    return mapping.topic
