"""Read the output of ``ros2 topic echo --csv`` for ``sensor_msgs/JointState``: rows without a header.

Each row has the stamp, the frame and the elements of the arrays; an empty array is one empty cell.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa

from torchrbd.errors import RecordingError
from torchrbd.recordings.formats.csv_files import CsvTable
from torchrbd.recordings.formats.csv_head import Head, first_lines, is_number

_STAMP = ("stamp.sec", "stamp.nanosec")
_FIXED = (*_STAMP, "frame_id")
_ARRAYS_OF = ("q", "qd", "tau")
_ARRAYS = "its columns are header.stamp.sec, nanosec, frame_id, names, positions, velocities, efforts"


def is_echo(path: Path) -> bool:
    """Return whether a file begins with seconds, nanoseconds, a frame and a joint's name."""
    cells = _first_row(path)
    stamped = len(cells) > len(_FIXED) + 1 and all(cell.strip().isdigit() for cell in cells[:2])
    return stamped and not is_number(cells[3]) and is_number(cells[-1])


class EchoTable:
    """Stream `t` and `q_<joint>`, with velocities and efforts `qd_<joint>`, `tau_<joint>`."""

    def __init__(self, path: Path):
        self.path = path
        rest = _first_row(path)[len(_FIXED) :]
        count = next((k for k, cell in enumerate(rest) if is_number(cell)), len(rest))
        self._joints = tuple(cell.strip() for cell in rest[:count])
        self._names = tuple(f"name[{index}]" for index in range(count))
        found = self._arrays(rest[count:])
        self._csv = CsvTable(path, Head(0, ",", ".", (*_FIXED, *self._names, *found)))
        self.columns = ("t", *(name for name in found if name not in _ARRAYS_OF))

    def batches(self, columns: Sequence[str], rows: int) -> Iterator[np.ndarray]:
        signals, start, row = [name for name in columns if name != "t"], None, 1
        for batch in self._csv.cells([*_STAMP, *signals], rows, self._names):
            self._check_names(batch, row)
            numbers = {name: batch[name].to_numpy(zero_copy_only=False) for name in (*_STAMP, *signals)}
            seconds, nanoseconds = (numbers[name] for name in _STAMP)
            start = seconds[0] if start is None else start
            numbers["t"] = (seconds - start) + 1e-9 * nanoseconds
            row += batch.num_rows
            yield np.stack([numbers[name] for name in columns])

    def _arrays(self, cells: list[str]) -> list[str]:
        """Return the columns for the array cells of row 1; an empty array is one column with its signal's name.

        Raises:
            RecordingError: the cells do not fit positions, velocities and efforts.
        """
        count, found, rest = len(self._joints), list[str](), [cell.strip() for cell in cells]
        for signal in _ARRAYS_OF:
            full = len(rest) >= count and all(rest[:count])
            found += [f"{signal}_{joint}" for joint in self._joints] if full else [signal]
            rest = rest[count if full else 1 :] if full or rest[:1] == [""] else ["missing"]
        if len(cells) == 2 * count and all(cells):
            raise RecordingError(
                f"{self.path}: two arrays for {count} joints; whether the latter is velocity or effort is unknown: "
                "record a bag with 'ros2 bag record', or put a header above rows of t, positions and efforts"
            )
        if rest:
            raise RecordingError(f"{self.path}: {len(cells)} numbers for {count} joint names in row 1; {_ARRAYS}")
        return found

    def _check_names(self, batch: pa.RecordBatch, row: int) -> None:
        for name, joint in zip(self._names, self._joints, strict=True):
            others = [text for text in batch[name].unique().to_pylist() if text.strip() != joint]
            if others:
                raise RecordingError(
                    f"{self.path}: data row {row + batch[name].to_pylist().index(others[0])} is of joint '{others[0]}' "
                    f"where row 1 is of '{joint}'; record a bag with 'ros2 bag record', or keep the rows of one node"
                )


def _first_row(path: Path) -> list[str]:
    lines = first_lines(path)
    return lines[0].rstrip("\r\n").split(",") if lines else []
