"""Read the YAML file that says which columns of a recording hold what, in which units."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from torchrbd.errors import RecordingError, closest
from torchrbd.recordings.strict_yaml import strict_yaml

SIGNALS = ("q", "qd", "qdd", "tau", "q_ref", "q_link", "temperature")
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
_TOP_KEYS = ("time", "joints", "topic", "episodes", "torque_delay")
_LONGEST_DELAY_S = 1.0
_SIGNAL_KEYS = ("column", "unit", "sign", "scale", "offset", "gear_ratio")
_CURRENT_KEYS = ("current", "unit", "torque_constant", "sign", "scale", "offset", "gear_ratio")


@dataclass(frozen=True)
class Source:
    """Name the column that a signal comes from: `signal = scale * column + offset`, in SI units."""

    column: str
    scale: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True)
class Mapping:
    """Hold where time and each joint's signals are found; what it does not name is looked for under its usual name.

    Attributes:
        file: where the mapping was read, for messages.
        time: the column of time.
        joints: joint name, or "*" for every joint, to signal (q, qd, qdd, tau, q_ref, q_link, temperature) to
            its source.
        topic: the topic of a ROS bag or of a PlotJuggler export; None for the only one of joint states.
        episodes: those of a LeRobot data set, numbered from 0; None for all.
        torque_delay_s: how much later torques are written than the positions that they belong to [s].
    """

    file: str = ""
    time: Source = Source("t")
    joints: dict[str, dict[str, Source]] = field(default_factory=dict)
    topic: str | None = None
    episodes: tuple[int, ...] | None = None
    torque_delay_s: float = 0.0

    def source(self, joint: str, index: int, signal: str) -> Source:
        """Return the source of a joint's signal; `{joint}` and `{index}` in a column's name are filled in."""
        for name in (joint, _EVERY_JOINT):
            found = self.joints.get(name, {}).get(signal)
            if found is not None:
                column = found.column.replace("{joint}", joint).replace("{index}", str(index))
                return Source(column, found.scale, found.offset)
        return Source(f"{signal}_{joint}")

    def named(self, joints: Sequence[str]) -> list[Source]:
        """Return the sources that are named for single joints: a recording must have them."""
        return [self.source(joint, joints.index(joint), key) for joint in joints for key in self.joints.get(joint, {})]

    def check_joints(self, joints: Sequence[str]) -> None:
        """Raise RecordingError if the mapping names a joint that the robot lacks."""
        for name in self.joints:
            if name != _EVERY_JOINT and name not in joints:
                raise RecordingError(
                    f"{self.file}: joints: the robot has no joint '{name}'{meant(name, joints)}; "
                    f"its joints are {', '.join(joints)}"
                )


def read_mapping(path: str | Path) -> Mapping:
    """Read and check a mapping.

    The file holds `time: {column, unit}` and `joints: {<joint>: {<signal>: {column, unit, sign, scale, offset,
    gear_ratio}}}` with signals q, qd, qdd, tau, q_ref (set-point), q_link (encoder behind the gear), temperature. A
    signal may be just the column's name. The joint "*" stands for every joint; `{joint}` and `{index}` (from 0) in a
    column's name are filled in. With a gear ratio the column is the motor's: `q = motor / gear_ratio`,
    `tau = motor * gear_ratio`. A torque may come from a current: `{current, torque_constant, unit, gear_ratio, sign,
    offset}`, `tau = current * torque_constant * gear_ratio`. Offsets are added last, in SI units of the joint.
    `topic` chooses among several of a ROS bag or PlotJuggler export, `episodes: [0, 3]` among those of a LeRobot set.
    `torque_delay: 0.004` is how much later [s] torques are written than the positions that they belong to, less than
    zero if earlier.

    Raises: RecordingError naming the file, the key and the closest valid one.
    """
    path = Path(path)
    try:
        content = strict_yaml(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise RecordingError(f"{path}: cannot read the mapping: {error.strerror}; name a YAML file") from None
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise RecordingError(f"{path}: not valid YAML: {' '.join(str(error).split())}") from None
    reader = _Reader(str(path))
    top = reader.table(content, "the file", _TOP_KEYS)
    time = reader.time(top["time"]) if "time" in top else Source("t")
    joints = {}
    for joint, signals in reader.table(top.get("joints", {}), "joints").items():
        where = f"joints.{joint}"
        table = reader.table(signals, where, SIGNALS)
        joints[joint] = {name: reader.signal(entry, name, f"{where}.{name}") for name, entry in table.items()}
    delay, topic, episodes = reader.delay(top), reader.topic(top.get("topic")), reader.episodes(top.get("episodes"))
    return Mapping(str(path), time, joints, topic, episodes, delay)


def meant(name: str, known: Iterable[str]) -> str:
    """Return `closest` in brackets, behind a space."""
    hint = closest(name, known)
    return f" ({hint})" if hint else ""


def chosen_topic(topics: dict[str, str], mapping: Mapping, place: str) -> str:
    """Return the topic that the mapping names, or the only one.

    Args:
        topics: what to say of each, by its name.
        mapping: the user's.
        place: the file, for messages.

    Raises:
        RecordingError: the mapping names another, or none where there are several.
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


@dataclass(frozen=True)
class _Reader:
    """Turn the YAML tree into sources, and every mistake into a message that names file and key."""

    file: str

    def fail(self, message: str) -> RecordingError:
        return RecordingError(f"{self.file}: {message}")

    def table(self, value: Any, where: str, keys: Sequence[str] | None = None) -> dict[str, Any]:
        if not isinstance(value, dict):
            expected = " or ".join(keys) if keys else "one key for each joint"
            raise self.fail(f"{where}: expected {expected}, got {value!r:.80}")
        for key in value:
            if not isinstance(key, str):
                raise self.fail(f"{where}: the key {key!r} must be text; put it in quotes")
            if keys is not None and key not in keys:
                hint = meant(key, keys)
                raise self.fail(f"{where}: unknown key '{key}'{hint}; valid keys are {', '.join(keys)}")
        return value

    def text(self, table: dict[str, Any], key: str, where: str) -> str:
        value = table.get(key)
        if not isinstance(value, str) or not value:
            raise self.fail(f"{where}.{key}: expected a column's name, got {value!r}")
        return value

    def topic(self, value: Any) -> str | None:
        if value is not None and not (isinstance(value, str) and value):
            raise self.fail(f"topic: expected a name such as /joint_states, got {value!r}")
        return value

    def episodes(self, value: Any) -> tuple[int, ...] | None:
        if value is None:
            return None
        numbers = value if isinstance(value, list) else [value]
        if not numbers or any(isinstance(one, bool) or not isinstance(one, int) or one < 0 for one in numbers):
            raise self.fail(f"episodes: expected numbers from 0 such as [0, 3], got {value!r}")
        return tuple(numbers)

    def delay(self, top: dict[str, Any]) -> float:
        found = self.number(top, "torque_delay", "", 0.0)
        if abs(found) > _LONGEST_DELAY_S:
            raise self.fail(f"torque_delay: expected seconds, at most {_LONGEST_DELAY_S:g} either way, got {found:g}")
        return found

    def number(self, table: dict[str, Any], key: str, where: str, default: float = 1.0) -> float:
        value = table.get(key, default)
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
            raise self.fail(f"{'.'.join(filter(None, (where, key)))}: expected a number, got {value!r}")
        return float(value)

    def factor(self, table: dict[str, Any], key: str, where: str) -> float:
        value = self.number(table, key, where)
        if value == 0:
            raise self.fail(f"{where}.{key}: zero would erase the signal")
        return value

    def unit(self, table: dict[str, Any], units: dict[str, float], default: str, where: str) -> float:
        name = table.get("unit", default)
        known = {_plain(key): value for key, value in units.items()}
        if not isinstance(name, str) or _plain(name) not in known:
            raise self.fail(f"{where}.unit: unknown unit {name!r}; valid units are {', '.join(units)}")
        return known[_plain(name)]

    def time(self, entry: Any) -> Source:
        if isinstance(entry, str):
            return Source(entry)
        table = self.table(entry, "time", ("column", "unit"))
        return Source(self.text(table, "column", "time"), self.unit(table, TIME_UNITS, "s", "time"))

    def signal(self, entry: Any, signal: str, where: str) -> Source:
        if isinstance(entry, str):
            return Source(entry)
        from_current = signal == "tau" and isinstance(entry, dict) and "current" in entry
        table = self.table(entry, where, _CURRENT_KEYS if from_current else _SIGNAL_KEYS)
        sign = self.number(table, "sign", where)
        if abs(sign) != 1:
            raise self.fail(f"{where}.sign: expected 1 or -1, got {sign:g}; use scale for other factors")
        scale = sign * self.factor(table, "scale", where)
        ratio = self.factor(table, "gear_ratio", where)
        offset = self.number(table, "offset", where, 0.0)
        if from_current:
            if "torque_constant" not in table:
                raise self.fail(f"{where}: a current needs its torque_constant [N m / A]")
            scale *= self.factor(table, "torque_constant", where) * self.unit(table, CURRENT_UNITS, "A", where)
            return Source(self.text(table, "current", where), scale * ratio, offset)
        scale *= self.unit(table, UNITS[signal], next(iter(UNITS[signal])), where)
        scale = scale * ratio if signal == "tau" else scale / ratio
        return Source(self.text(table, "column", where), scale, offset)


def _plain(unit: str) -> str:
    """Make 'N m', 'N*m' and 'Nm' one."""
    return unit.replace(" ", "").replace("*", "").replace("·", "")
