"""Parquet files."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
from pyarrow import parquet

from torchrbd.errors import RecordingError
from torchrbd.recordings.formats.csv_files import numbers_of
from torchrbd.recordings.formats.table import Format

_BUFFER_BYTES = 1 << 16


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
            with parquet.ParquetFile(self.path, buffer_size=_BUFFER_BYTES, pre_buffer=False) as file:
                for batch in file.iter_batches(rows, columns=list(columns), use_threads=False):
                    yield numbers_of(batch.select(list(columns)))
        except (pa.ArrowInvalid, OSError) as error:
            raise RecordingError(f"{self.path}: damaged Parquet file: {error}") from None


FORMATS = (Format((".parquet",), lambda path, _: ParquetTable(path)),)
