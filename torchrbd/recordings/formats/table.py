"""The table of numbers that every format opens as, and what a format is."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from torchrbd.recordings.mapping import Mapping as ColumnMapping


class Table(Protocol):
    """The columns of a table; streams those that are asked for."""

    columns: tuple[str, ...]

    def batches(self, columns: Sequence[str], rows: int) -> Iterator[np.ndarray]:
        """Yield arrays (len(columns), at most about `rows`) of float64, in file order; a missing cell is NaN."""
        ...


@dataclass(frozen=True)
class Format:
    """One kind of files or folders.

    A package offers one of its own as an entry point of the group "torchrbd.formats", an object of this class.

    Attributes:
        suffixes: of its files, in small letters, e.g. (".npz",); none if it is a folder.
        open: returns the table of a path; the mapping chooses what is to be read of it, such as a topic.
        marker: a folder with such a file in it is of this format.
    """

    suffixes: tuple[str, ...]
    open: Callable[[Path, ColumnMapping], Table]
    marker: str = ""


class ArrayTable:
    """Columns that are already in memory."""

    def __init__(self, columns: Mapping[str, np.ndarray]):
        self.columns = tuple(columns)
        self._data = columns

    def batches(self, columns: Sequence[str], rows: int) -> Iterator[np.ndarray]:
        length = len(self._data[columns[0]])
        for start in range(0, length, rows):
            yield np.stack([np.asarray(self._data[name][start : start + rows], dtype=np.float64) for name in columns])
