"""Read joint states from the bags of ROS 1 and ROS 2 and from MCAP files; no ROS is needed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from torchrbd.errors import RecordingError
from torchrbd.recordings.extras import needed
from torchrbd.recordings.formats.table import Format
from torchrbd.recordings.mapping import Mapping, chosen_topic

SUFFIXES = (".bag", ".mcap", ".db3")
_INDEX, _STORAGE = "metadata.yaml", {".db3", ".mcap"}
# Largest size of an index, checked before it is parsed [bytes].
_LARGEST_INDEX = 1 << 24
_JOINT_STATE = "sensor_msgs/msg/JointState"
_SIGNALS = {"q": "position", "qd": "velocity", "tau": "effort"}
# Number of messages that define joints and signals; several nodes may alternate on one topic.
_FIRST_MESSAGES = 500
# Largest number of cached orders of names.
_MOST_LAYOUTS = 256
_NS = 1_000_000_000
_Part = tuple[int, np.ndarray, np.ndarray]


def files(path: Path) -> list[Path]:
    """Return the files that are read of a ROS 2 bag's folder: its index, and messages, compressed or not."""
    return [one for one in sorted(path.iterdir()) if one.name == _INDEX or _STORAGE.intersection(one.suffixes)]


class _Message(NamedTuple):
    """One JointState: its stamp and the time it was recorded [ns], its joints, and an array for each of the signals."""

    stamp: int
    recorded: int
    joints: tuple[str, ...]
    arrays: tuple[np.ndarray, ...]


class RosTable:
    """Stream a topic of ``sensor_msgs/JointState``: `t`, `q_<joint>`, `qd_<joint>`, `tau_<joint>`.

    Times are those of ``header.stamp``; if the first messages have none, the times of recording. A joint that is not in
    a message has no values there.
    """

    def __init__(self, path: Path, mapping: Mapping):
        self.path = path
        if path.is_dir() and (path / _INDEX).stat().st_size > _LARGEST_INDEX:
            raise RecordingError(f"{path}: {_INDEX} is no bag's: it is larger than {_LARGEST_INDEX >> 20} MB")
        self._ros2 = path.suffix.lower() != ".bag" or path.is_dir()
        with self._opened() as bag:
            self._topic = _chosen(bag.connections, mapping, path)
            first = list(islice(self._messages(bag), _FIRST_MESSAGES))
        if not first:
            raise RecordingError(f"{path}: topic '{self._topic}' holds no messages")
        self._stamped = any(message.stamp for message in first)
        joints = dict.fromkeys(joint for message in first for joint in message.joints)
        self._slots: dict[str, tuple[int, str]] = {
            f"{signal}_{joint}": (index, joint)
            for index, signal in enumerate(_SIGNALS)
            for joint in joints
            if any(joint in message.joints and len(message.arrays[index]) for message in first)
        }
        self.columns = ("t", *self._slots)

    def batches(self, columns: Sequence[str], rows: int) -> Iterator[np.ndarray]:
        block, count, start = np.full((rows, len(columns)), np.nan), 0, None
        clock = [k for k, name in enumerate(columns) if name == "t"]
        layouts: dict[tuple[Any, ...], list[_Part]] = {}
        with self._opened() as bag:
            for number, message in enumerate(self._messages(bag), start=1):
                shape = (message.joints, *map(len, message.arrays))
                parts = layouts.get(shape)
                if parts is None:
                    if len(layouts) == _MOST_LAYOUTS:
                        layouts.clear()
                    parts = layouts[shape] = self._layout(message, columns, number)
                if not parts and len(columns) > len(clock):  # of another node on the same topic
                    continue
                time = message.stamp if self._stamped else message.recorded
                start = time if start is None else start
                block[count, clock] = (time - start) / _NS
                for index, there, here in parts:
                    block[count, here] = message.arrays[index][there]
                count += 1
                if count == rows:
                    yield block.T
                    block, count = np.full((rows, len(columns)), np.nan), 0
        if count:
            yield block[:count].T

    def _layout(self, message: _Message, columns: Sequence[str], number: int) -> list[_Part]:
        """Return how a message's values map to columns: index of the array, places in it, places among the columns."""
        place, found = {joint: k for k, joint in enumerate(message.joints)}, []
        for index, (field, array) in enumerate(zip(_SIGNALS.values(), message.arrays, strict=True)):
            if len(array) not in (0, len(message.joints)):
                raise RecordingError(
                    f"{self.path}: topic '{self._topic}', message {number}: {len(array)} values of {field} for "
                    f"{len(message.joints)} joint names; the node that publishes it is to be corrected"
                )
            slots = [(k, self._slots[name]) for k, name in enumerate(columns) if name != "t"]
            here = [k for k, (signal, joint) in slots if signal == index and joint in place and len(array)]
            if here:
                found.append((index, np.array([place[self._slots[columns[k]][1]] for k in here]), np.array(here)))
        return found

    def _messages(self, bag: Any) -> Iterator[_Message]:
        connections = [one for one in bag.connections if one.topic == self._topic and _is_joint_state(one)]
        typesys = needed("rosbags.typesys", "ros", self.path)
        # The message is the same in every distribution, so the types of other topics do not matter.
        store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE if self._ros2 else typesys.Stores.ROS1_NOETIC)
        read = store.deserialize_cdr if self._ros2 else store.deserialize_ros1
        for connection, recorded, raw in bag.messages(connections=connections):
            found = read(raw, connection.msgtype)
            stamp = found.header.stamp
            arrays = (found.position, found.velocity, found.effort)
            yield _Message(stamp.sec * _NS + stamp.nanosec, recorded, tuple(found.name), arrays)

    @contextmanager
    def _opened(self) -> Iterator[Any]:
        reader = needed(f"rosbags.rosbag{2 if self._ros2 else 1}", "ros", self.path).Reader
        try:
            with reader(self.path) as bag:
                yield bag
        except RecordingError:
            raise
        except Exception as error:  # damaged files fail anywhere in the library, in any way
            raise RecordingError(f"{self.path}: not a readable bag: {_reason(error)}{self._remedy()}") from None

    def _remedy(self) -> str:
        if not self._ros2:
            return "; 'rosbag reindex' and 'rosbag check' mend what was not closed"
        if self.path.is_dir():
            return f"; a bag that was not closed is mended by 'ros2 bag reindex {self.path.name}'"
        return "; a file that was not closed is mended by 'mcap recover'" if self.path.suffix == ".mcap" else ""


def _reason(error: Exception) -> str:
    return " ".join(str(error).split()).rstrip(".") or type(error).__name__


def _is_joint_state(connection: Any) -> bool:
    return connection.msgtype == _JOINT_STATE


def _chosen(connections: Sequence[Any], mapping: Mapping, path: Path) -> str:
    """Return the topic to read: that of the mapping, or the only one of joint states.

    Raises:
        RecordingError: there is none, or more than one and the mapping does not say which.
    """
    counts: dict[str, int] = {}
    for one in connections:
        if _is_joint_state(one):
            counts[one.topic] = counts.get(one.topic, 0) + (one.msgcount or 0)
    if not counts:
        others = ", ".join(sorted({f"{one.topic} ({one.msgtype})" for one in connections})) or "none"
        raise RecordingError(
            f"{path}: no topic of sensor_msgs/JointState; its topics are {others}; record the joint states with effort"
        )
    return chosen_topic({topic: f"{count} messages" for topic, count in counts.items()}, mapping, str(path))


FORMATS = (Format(SUFFIXES, RosTable), Format((), RosTable, _INDEX))
