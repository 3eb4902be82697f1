"""Stream CSV files; errors name the cell."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
from pyarrow import csv as arrow_csv

from torchrbd.errors import RecordingError
from torchrbd.recordings.formats.csv_head import MISSING, Head, is_number, read_head

_BLOCK_BYTES = 1 << 20


class CsvTable:
    """Stream a CSV file: comma, semicolon, tab or space; decimal points or commas; comments before the header."""

    def __init__(self, path: Path, head: Head | None = None):
        self.path = path
        self._head = head or read_head(path)
        self.columns = self._head.columns

    def batches(self, columns: Sequence[str], rows: int) -> Iterator[np.ndarray]:
        for batch in self.cells(columns, rows):
            yield numbers_of(batch)

    def cells(self, columns: Sequence[str], rows: int, texts: Sequence[str] = ()) -> Iterator[pa.RecordBatch]:
        """Yield the cells of `columns` as numbers, then those of `texts`."""
        types = {name: pa.float64() for name in columns} | {name: pa.string() for name in texts}
        try:
            reader = arrow_csv.open_csv(
                self.path,
                arrow_csv.ReadOptions(
                    use_threads=False,
                    block_size=_BLOCK_BYTES,
                    skip_rows=self._head.skip,
                    column_names=list(self.columns),
                ),
                arrow_csv.ParseOptions(delimiter=self._head.separator),
                arrow_csv.ConvertOptions(
                    column_types=types,
                    include_columns=list(types),
                    null_values=list(MISSING),
                    decimal_point=self._head.decimal,
                ),
            )
            for batch in reader:
                for start in range(0, batch.num_rows, rows):
                    yield batch.slice(start, rows)
        except pa.ArrowInvalid as error:
            if "Empty CSV file" in str(error):
                return
            raise self._explain(columns, error) from None

    def _explain(self, columns: Sequence[str], error: Exception) -> RecordingError:
        """Find the first cell or row that cannot be read, slowly."""
        wanted, decimal = [self.columns.index(name) for name in columns], self._head.decimal
        with self.path.open(encoding="utf-8-sig", newline="", errors="replace") as stream:
            for _ in range(self._head.skip):
                stream.readline()
            rows = (row for row in csv.reader(stream, delimiter=self._head.separator) if row)
            for number, row in enumerate(rows, start=1):
                if len(row) != len(self.columns):
                    return RecordingError(
                        f"{self.path}: data row {number} has {len(row)} cells, but the header has "
                        f"{len(self.columns)} columns{self._comma_remedy(len(row))}"
                    )
                for index in wanted:
                    if not is_number(row[index], decimal):
                        return RecordingError(
                            f"{self.path}: column '{self.columns[index]}', data row {number}: expected a number, "
                            f"got '{row[index].strip()}'; {_remedy(row[index], decimal)}"
                        )
        return RecordingError(f"{self.path}: not a readable CSV file: {error}")

    def _comma_remedy(self, cells: int) -> str:
        if self._head.separator != "," or cells <= len(self.columns):
            return ""
        return "; numbers with decimal commas are to be in quotes, or their cells separated by semicolons"


def numbers_of(batch: pa.RecordBatch) -> np.ndarray:
    """Return the cells of a batch of numbers, (columns, rows) of float64."""
    return np.stack([column.cast(pa.float64()).to_numpy(zero_copy_only=False) for column in batch.columns])


def _remedy(cell: str, decimal: str) -> str:
    """Return the remedy for a cell that is not a number."""
    if not is_number(cell, "," if decimal == "." else "."):
        return "leave a missing cell empty or write nan"
    here, there = ("comma", "points") if decimal == "." else ("point", "commas")
    return f"a decimal {here}, where the file's first numbers have decimal {there} or none; write all alike"
