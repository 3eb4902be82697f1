"""Read tables of numbers from CSV, Parquet and NPZ files in bounded memory, or say exactly which cell is wrong."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from collections.abc import Mapping as Named
from pathlib import Path
from typing import Protocol

import numpy as np
import pyarrow as pa
from pyarrow import csv as arrow_csv
from pyarrow import parquet

from torchrbd.errors import RecordingError
from torchrbd.recordings.mapping import Mapping
from torchrbd.recordings.matlab import MatTable
from torchrbd.recordings.npz import NpzTable
from torchrbd.recordings.ros_bags import RosTable

_CSV_BLOCK_BYTES = 1 << 20
_PARQUET_BUFFER_BYTES = 1 << 16
_BAGS = (".bag", ".mcap", ".db3")
_EXPECTED = ".csv, .parquet, .npz, .mat, .bag, .mcap or the folder of a ROS 2 bag"
# Of a bag, before its text is parsed [bytes].
_LARGEST_METADATA = 1 << 24
_FIRST_CHARACTERS = 4096
_MISSING = ("", "nan", "NaN", "NAN", "-nan", "null", "NULL", "None", "NA", "N/A")


class Table(Protocol):
    """Name the columns of a table and stream those that are asked for."""

    columns: tuple[str, ...]

    def batches(self, columns: Sequence[str], rows: int) -> Iterator[np.ndarray]:
        """Yield arrays (len(columns), at most about `rows`) of float64, in file order; a missing cell is NaN."""
        ...


def open_table(path: Path, mapping: Mapping) -> Table:
    """Open a file by its suffix, or a folder by what it holds.

    Args:
        path: the file or folder.
        mapping: which topic or episodes of it are meant.

    Raises:
        RecordingError: it does not exist, is no table, or has an unknown suffix.
    """
    if path.is_dir():
        return _open_folder(path, mapping)
    readers = {".csv": CsvTable, ".txt": CsvTable, ".tsv": CsvTable, ".parquet": ParquetTable, ".npz": NpzTable}
    readers |= {".mat": MatTable}
    suffix = path.suffix.lower()
    reader = readers.get(suffix)
    if reader is None and suffix not in _BAGS:
        raise RecordingError(f"{path}: cannot read '{path.suffix}' files; expected {_EXPECTED}")
    if not path.is_file():
        raise RecordingError(f"{path}: no such file")
    if path.stat().st_size == 0:
        raise RecordingError(f"{path}: the file is empty")
    return RosTable(path, mapping) if reader is None else reader(path)


def _open_folder(path: Path, mapping: Mapping) -> Table:
    """Open a ROS 2 bag."""
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
    raise RecordingError(f"{path}: a folder, and no ROS 2 bag (metadata.yaml); give its files one by one")


class ArrayTable:
    """Serve columns that are already in memory."""

    def __init__(self, columns: Named[str, np.ndarray]):
        self.columns = tuple(columns)
        self._data = columns

    def batches(self, columns: Sequence[str], rows: int) -> Iterator[np.ndarray]:
        length = len(self._data[columns[0]])
        for start in range(0, length, rows):
            yield np.stack([np.asarray(self._data[name][start : start + rows], dtype=np.float64) for name in columns])


class CsvTable:
    """Stream a CSV file: comma, semicolon, tab or space; comments before the header are skipped."""

    def __init__(self, path: Path):
        self.path = path
        self._skip, self._delimiter, self.columns, first_rows = _read_header(path)
        # 1,5;2,5 is how spreadsheets in half of Europe write 1.5 and 2.5
        self._decimal = "," if self._delimiter == ";" and "," in first_rows else "."

    def batches(self, columns: Sequence[str], rows: int) -> Iterator[np.ndarray]:
        try:
            reader = arrow_csv.open_csv(
                self.path,
                arrow_csv.ReadOptions(
                    use_threads=False,
                    block_size=_CSV_BLOCK_BYTES,
                    skip_rows=self._skip,
                    column_names=list(self.columns),
                ),
                arrow_csv.ParseOptions(delimiter=self._delimiter),
                arrow_csv.ConvertOptions(
                    column_types={name: pa.float64() for name in columns},
                    include_columns=list(columns),
                    null_values=list(_MISSING),
                    decimal_point=self._decimal,
                ),
            )
            for batch in reader:
                for start in range(0, batch.num_rows, rows):
                    yield _to_numpy(batch.slice(start, rows))
        except pa.ArrowInvalid as error:
            if "Empty CSV file" in str(error):
                return
            raise self._explain(columns, error) from None

    def _explain(self, columns: Sequence[str], error: Exception) -> RecordingError:
        """Find the first cell or row that cannot be read, the slow way."""
        wanted = [self.columns.index(name) for name in columns]
        with self.path.open(encoding="utf-8-sig", newline="", errors="replace") as stream:
            for _ in range(self._skip):
                stream.readline()
            rows = (row for row in csv.reader(stream, delimiter=self._delimiter) if row)
            for number, row in enumerate(rows, start=1):
                if len(row) != len(self.columns):
                    return RecordingError(
                        f"{self.path}: data row {number} has {len(row)} cells, but the header has "
                        f"{len(self.columns)} columns"
                    )
                for index in wanted:
                    if not _is_number(row[index], self._decimal):
                        return RecordingError(
                            f"{self.path}: column '{self.columns[index]}', data row {number}: expected a number, "
                            f"got '{row[index].strip()}'; leave a missing cell empty or write nan"
                        )
        return RecordingError(f"{self.path}: not a readable CSV file: {error}")


class ParquetTable:
    """Stream a Parquet file page by page, whatever the size of its row groups."""

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
                    yield _to_numpy(batch.select(list(columns)))
        except (pa.ArrowInvalid, OSError) as error:
            raise RecordingError(f"{self.path}: damaged Parquet file: {error}") from None


def _to_numpy(batch: pa.RecordBatch) -> np.ndarray:
    return np.stack([column.cast(pa.float64()).to_numpy(zero_copy_only=False) for column in batch.columns])


def _is_number(text: str, decimal: str = ".") -> bool:
    text = text.strip()
    if text in _MISSING:
        return True
    try:
        float(text.replace(decimal, "."))
    except ValueError:
        return False
    return True


def _read_header(path: Path) -> tuple[int, str, tuple[str, ...], str]:
    """Find the header: the first line that is no comment, or the comment just above the first row of numbers.

    Returns: the number of lines to skip, the delimiter, the columns' names, the first data rows.
    """
    comment, skip = "", 0
    with path.open(encoding="utf-8-sig", newline="", errors="replace") as stream:
        line = stream.readline()
        while line and (line.startswith("#") or not line.strip()):
            comment, skip, line = line.lstrip("# ") if line.strip() else comment, skip + 1, stream.readline()
        delimiter = max(",;\t", key=line.count) if any(mark in line for mark in ",;\t") else " "
        cells = [cell.strip() for cell in next(csv.reader([line], delimiter=delimiter), [])]
        first_rows = line
        if cells and all(_is_number(cell) or _is_number(cell, ",") for cell in cells):
            cells = [cell.strip() for cell in next(csv.reader([comment], delimiter=delimiter), [])]
            if len(cells) != len(next(csv.reader([line], delimiter=delimiter))):
                raise RecordingError(
                    f"{path}: the first row holds numbers; expected a header with the columns' names, "
                    f"such as t,q_joint1,tau_joint1"
                )
        else:
            first_rows, skip = stream.read(_FIRST_CHARACTERS), skip + 1
    if not cells:
        raise RecordingError(f"{path}: no header found; expected the columns' names in the first row")
    if not first_rows.strip():
        raise RecordingError(f"{path}: the file has a header but no rows")
    twice = sorted({name for name in cells if cells.count(name) > 1 and name})
    if twice:
        raise RecordingError(f"{path}: column '{twice[0]}' appears more than once in the header")
    return skip, delimiter, tuple(name or f"(unnamed {index})" for index, name in enumerate(cells, 1)), first_rows
