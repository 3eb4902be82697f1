"""Read LeRobot data sets: folders with meta/info.json and Parquet files, whose episodes are segments of a recording."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from pyarrow import parquet

from torchrbd.errors import RecordingError
from torchrbd.recordings.formats.table import Format
from torchrbd.recordings.mapping import Mapping

INFO = Path("meta") / "info.json"
_DATA = "data/chunk-*/*.parquet"
_TIME, _EPISODE = "timestamp", "episode_index"
_BUFFER_BYTES, _LARGEST_INFO = 1 << 16, 1 << 24
# Least pause between episodes, in seconds and frames: nothing is interpolated between them.
_PAUSE, _FRAMES = 1.0, 10


@dataclass(frozen=True)
class _Slot:
    """A column's feature, its place in the feature's vector, and the vector's length."""

    feature: str
    index: int
    width: int


class LeRobotTable:
    """Stream the frames of a data set of version 2 or 3: `t`, and the features' elements.

    An element with a name in ``info.json`` is the column `<feature>/<name>`, others are `<feature>[0]`, `<feature>[1]`.
    A feature of one number is just `<feature>`. Episodes follow each other in `t`, with a pause between them.
    """

    def __init__(self, path: Path, mapping: Mapping):
        self.path = path
        info = _read_info(path)
        self._slots = dict(_slots(info["features"]))
        for name in (_TIME, _EPISODE):
            if name not in self._slots:
                raise RecordingError(f"{path / INFO}: features: '{name}' is missing; expected a LeRobot data set")
        self.columns = ("t", *(name for name in self._slots if name != _TIME))
        rate = info.get("fps")
        self._pause = max(_PAUSE, _FRAMES / rate) if isinstance(rate, (int, float)) and rate > 0 else _PAUSE
        _, *self._files = files(path)
        if not self._files:
            raise RecordingError(f"{path}: no files {_DATA}; download the whole data set")
        self._episodes = None if mapping.episodes is None else np.array(mapping.episodes)
        total = info.get("total_episodes")
        if isinstance(total, int) and mapping.episodes and max(mapping.episodes) >= total:
            raise RecordingError(
                f"{path}: episodes: there is no {max(mapping.episodes)}; the set has {total}, numbered from 0"
            )

    def batches(self, columns: Sequence[str], rows: int) -> Iterator[np.ndarray]:
        wanted = [self._slots[name] for name in columns if name != "t"]
        features = list(dict.fromkeys([_TIME, _EPISODE, *(slot.feature for slot in wanted)]))
        clock = _Clock(self._pause)
        for file in self._files:
            for batch in self._batches(file, features, rows):
                data = {name: self._numbers(batch, name, file) for name in features}
                episode = data[_EPISODE][:, 0]
                keep = slice(None) if self._episodes is None else np.isin(episode, self._episodes)
                if not len(episode[keep]):
                    continue
                t = clock.times(data[_TIME][keep, 0], episode[keep])
                slots = (None if name == "t" else self._slots[name] for name in columns)
                yield np.stack([t if slot is None else data[slot.feature][keep, slot.index] for slot in slots])

    def _batches(self, path: Path, features: list[str], rows: int) -> Iterator[pa.RecordBatch]:
        try:
            with parquet.ParquetFile(path, buffer_size=_BUFFER_BYTES, pre_buffer=False) as file:
                lacking = [name for name in features if name not in file.schema_arrow.names]
                if lacking:
                    raise RecordingError(f"{path}: column '{lacking[0]}' is missing; {INFO} has it")
                yield from file.iter_batches(rows, columns=features, use_threads=False)
        except (pa.ArrowException, OSError) as error:
            raise RecordingError(f"{path}: not a readable Parquet file: {error}") from None

    def _numbers(self, batch: pa.RecordBatch, feature: str, file: Path) -> np.ndarray:
        """Return a feature (rows, width)."""
        column: Any = batch[feature]
        width = next(slot.width for slot in self._slots.values() if slot.feature == feature)
        nested = isinstance(column, (pa.ListArray, pa.LargeListArray, pa.FixedSizeListArray))
        flat = column.flatten() if nested else column
        if len(flat) != width * batch.num_rows:
            raise RecordingError(f"{file}: column '{feature}': expected {width} numbers in each row, as {INFO} has it")
        try:
            numbers = flat.cast(pa.float64()).to_numpy(zero_copy_only=False)
        except pa.ArrowException:
            raise RecordingError(f"{file}: column '{feature}' holds {column.type}; expected numbers") from None
        return numbers.reshape(batch.num_rows, width)


def files(path: Path) -> list[Path]:
    """Return the files that are read of a data set, its information first."""
    return [path / INFO, *sorted(path.glob(_DATA))]


class _Clock:
    """Put the times of episodes, each of which starts at zero, one after the other."""

    def __init__(self, pause: float):
        self._pause, self._episode, self._shift, self._latest = pause, np.nan, 0.0, -pause

    def times(self, t: np.ndarray, episode: np.ndarray) -> np.ndarray:
        """Return times (N,) of consecutive frames [s]."""
        found = np.empty(len(t))
        starts = np.flatnonzero(np.diff(episode, prepend=np.nan) != 0)
        for start, end in zip(starts, (*starts[1:], len(t)), strict=True):
            if episode[start] != self._episode:
                self._episode, self._shift = episode[start], self._latest + self._pause - t[start]
            found[start:end] = t[start:end] + self._shift
            self._latest = found[end - 1]
        return found


def _read_info(path: Path) -> dict[str, Any]:
    file = path / INFO
    if file.stat().st_size > _LARGEST_INFO:
        raise RecordingError(f"{file}: is larger than {_LARGEST_INFO >> 20} MB; expected the features of a data set")
    try:
        info = json.loads(file.read_text(encoding="utf-8"))
    except (ValueError, RecursionError, OSError) as error:
        raise RecordingError(f"{file}: cannot be read as JSON: {error}") from None
    if not isinstance(info, dict) or not isinstance(info.get("features"), dict):
        raise RecordingError(f"{file}: has no 'features'; expected a LeRobot data set of version 2 or 3")
    return info


def _slots(features: dict[str, Any]) -> Iterator[tuple[str, _Slot]]:
    """Yield the columns of all features that are numbers or vectors of numbers."""
    for name, feature in features.items():
        if not isinstance(feature, dict) or not str(feature.get("dtype")).startswith(("float", "int")):
            continue
        shape = feature.get("shape")
        if not (isinstance(shape, list) and len(shape) == 1 and isinstance(shape[0], int) and shape[0] > 0):
            continue
        width, names = shape[0], _names(feature.get("names"))
        if len(names) == width:
            columns = [f"{name}/{one}" for one in names]
        else:
            columns = [name] if width == 1 else [f"{name}[{index}]" for index in range(width)]
        for index, column in enumerate(columns):
            yield column, _Slot(name, index, width)


def _names(given: Any) -> list[str]:
    """Return the elements' names, which may be grouped: {"motors": [...]}."""
    if isinstance(given, dict):
        lists = [_names(value) for value in given.values()]
        return [name for names in lists for name in names]
    return [str(name) for name in given] if isinstance(given, list) else []


FORMATS = (Format((), LeRobotTable, str(INFO)),)
