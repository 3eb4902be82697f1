"""Open tables of numbers in files and folders of many formats, each read in bounded memory."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from collections.abc import Mapping as Named
from pathlib import Path
from typing import Protocol

import numpy as np
import pyarrow as pa
from pyarrow import parquet

from torchrbd.errors import RecordingError
from torchrbd.recordings.csv_files import CsvTable, numbers_of
from torchrbd.recordings.lerobot import INFO, LeRobotTable
from torchrbd.recordings.mapping import Mapping
from torchrbd.recordings.matlab import MatTable
from torchrbd.recordings.npz import NpzTable
from torchrbd.recordings.ros_bags import RosTable
from torchrbd.recordings.ros_echo import EchoTable, is_echo

_PARQUET_BUFFER_BYTES = 1 << 16
_TEXTS = (".csv", ".txt", ".tsv")
_BAGS = (".bag", ".mcap", ".db3")
STATISTICS = ".stats"
"""Suffix of files with second moments, which are not tables."""
_EXPECTED = ".csv, .parquet, .npz, .mat, .bag, .mcap or the folder of a ROS 2 bag or LeRobot set"
# Largest size of a bag's metadata, checked before it is parsed [bytes].
_LARGEST_METADATA = 1 << 24


class Table(Protocol):
    """The columns of a table; streams those that are asked for."""

    columns: tuple[str, ...]

    def batches(self, columns: Sequence[str], rows: int) -> Iterator[np.ndarray]:
        """Yield arrays (len(columns), at most about `rows`) of float64, in file order; a missing cell is NaN."""
        ...


def open_table(path: Path, mapping: Mapping) -> Table:
    """Open a file by its suffix, or a folder by its content.

    Args:
        path: the file or folder.
        mapping: chooses its topic or episodes.

    Raises:
        RecordingError: it does not exist, is not a table, or has an unknown suffix.
    """
    if path.is_dir():
        return _open_folder(path, mapping)
    readers = {**dict.fromkeys(_TEXTS, _open_text), ".parquet": ParquetTable, ".npz": NpzTable, ".mat": MatTable}
    suffix = path.suffix.lower()
    reader = readers.get(suffix)
    if suffix == STATISTICS:
        raise RecordingError(
            f"{path}: holds second moments, not rows; only 'torchrbd identify' takes them, give the recording itself"
        )
    if reader is None and suffix not in _BAGS:
        raise RecordingError(f"{path}: cannot read '{path.suffix}' files; expected {_EXPECTED}")
    if not path.is_file():
        raise RecordingError(f"{path}: no such file; check the path")
    if path.stat().st_size == 0:
        raise RecordingError(f"{path}: the file is empty; leave it out, or record again")
    return RosTable(path, mapping) if reader is None else reader(path)


def _open_text(path: Path) -> Table:
    return EchoTable(path) if is_echo(path) else CsvTable(path)


def _open_folder(path: Path, mapping: Mapping) -> Table:
    """Open a LeRobot data set or a ROS 2 bag."""
    if (path / INFO).is_file():
        return LeRobotTable(path, mapping)
    if (path / "metadata.yaml").is_file():
        if (path / "metadata.yaml").stat().st_size > _LARGEST_METADATA:
            raise RecordingError(f"{path}: metadata.yaml is no bag's: it is larger than {_LARGEST_METADATA >> 20} MB")
        return RosTable(path, mapping)
    inside = sorted(entry.name for entry in path.iterdir() if entry.suffix in _BAGS)
    if inside:
        raise RecordingError(
            f"{path}: a ROS 2 bag without metadata.yaml, it was not closed: 'ros2 bag reindex {path.name}' writes it, "
            f"or give {path / inside[0]}"
        )
    raise RecordingError(
        f"{path}: a folder, and neither a ROS 2 bag (metadata.yaml) nor a LeRobot data set ({INFO}); give "
        "its files one by one"
    )


class ArrayTable:
    """Columns that are already in memory."""

    def __init__(self, columns: Named[str, np.ndarray]):
        self.columns = tuple(columns)
        self._data = columns

    def batches(self, columns: Sequence[str], rows: int) -> Iterator[np.ndarray]:
        length = len(self._data[columns[0]])
        for start in range(0, length, rows):
            yield np.stack([np.asarray(self._data[name][start : start + rows], dtype=np.float64) for name in columns])


class ParquetTable:
    """Stream a Parquet file page by page, for any size of its row groups."""

    def __init__(self, path: Path):
        self.path = path
        try:
            schema = parquet.read_schema(path)
        except (pa.ArrowInvalid, OSError) as error:
            raise RecordingError(f"{path}: not a readable Parquet file: {error}") from None
        self.columns = tuple(schema.names)
        self._types = dict(zip(schema.names, schema.types, strict=True))

    def batches(self, columns: Sequence[str], rows: int) -> Iterator[np.ndarray]:
        for name in columns:
            kind = self._types[name]
            if not (pa.types.is_floating(kind) or pa.types.is_integer(kind) or pa.types.is_null(kind)):
                raise RecordingError(f"{self.path}: column '{name}' holds {kind}; expected numbers")
        try:
            with parquet.ParquetFile(self.path, buffer_size=_PARQUET_BUFFER_BYTES, pre_buffer=False) as file:
                for batch in file.iter_batches(rows, columns=list(columns), use_threads=False):
                    yield numbers_of(batch.select(list(columns)))
        except (pa.ArrowInvalid, OSError) as error:
            raise RecordingError(f"{self.path}: damaged Parquet file: {error}") from None
