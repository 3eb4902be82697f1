"""Recordings in memory: tables such as those of pandas and polars, and dicts of arrays."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, TypeGuard

import numpy as np
import pyarrow as pa
import torch

from torchrbd.errors import RecordingError
from torchrbd.recordings.formats.npz import NPZ_SIGNALS, check_shapes


class Frame(Protocol):
    """A table: its columns' names in ``columns``, and ``table[name].to_numpy()``, as in pandas and polars."""

    @property
    def columns(self) -> Iterable[Any]: ...

    def __getitem__(self, key: Any, /) -> Any: ...


Data = Frame | Mapping[str, Any]
"""A recording in memory, see ``open_recording``."""


@dataclass(frozen=True, eq=False)
class InMemory:
    """A recording in memory, with its name in results; the robot is not known yet."""

    name: str
    data: Data


def is_data(source: object) -> TypeGuard[Data]:
    """Return whether something is a table or a dict."""
    return isinstance(source, Mapping) or (hasattr(source, "columns") and hasattr(source, "__getitem__"))


def memory_table(data: Data, joints: Sequence[str], place: str) -> MemoryTable:
    """Return the columns of a table or of a dict of arrays.

    Args:
        data: the table or dict.
        joints: the robot's; arrays (N, n) without joint names have this order.
        place: name of the recording in messages.

    Raises:
        RecordingError: names that are not text or appear twice, arrays (N, n) with shapes that do not fit.
    """
    if isinstance(data, Mapping):
        names = list(data)
        signals = [name for name in NPZ_SIGNALS if name in data]
        stacked = "joints" in data or any(_array(data[name], name, place).ndim > 1 for name in signals)
        columns = _unstacked(data, joints, place) if stacked else dict(data)
    else:
        names = list(data.columns)
        columns = {name: data[name] for name in names if isinstance(name, str)}
    for name in names:
        if not isinstance(name, str):
            raise RecordingError(
                f"{place}: a column is called {name!r:.50}; expected text such as t, q_joint1, tau_joint1"
            )
        if names.count(name) > 1:
            raise RecordingError(f"{place}: column '{name}' appears more than once")
    return MemoryTable(columns, place)


class MemoryTable:
    """Columns in memory; those of numpy, torch, pandas or polars are not copied as a whole."""

    def __init__(self, columns: Mapping[str, Any], place: str):
        self.columns = tuple(columns)
        self._place, self._given = place, columns
        self._arrays: dict[str, np.ndarray] = {}

    def check(self, columns: Sequence[str]) -> None:
        """Raise RecordingError for columns that are not numbers, or not as long as the first one."""
        length = self._numbers(columns[0]).shape[0] if self._numbers(columns[0]).ndim else 0
        if not length:
            raise RecordingError(f"{self._place}: there are no rows; '{columns[0]}' is empty")
        for name in columns:
            shape = self._numbers(name).shape
            if shape != (length,):
                raise RecordingError(
                    f"{self._place}: column '{name}' has shape {shape}; expected ({length},), a row for each of "
                    f"'{columns[0]}'"
                )

    def batches(self, columns: Sequence[str], rows: int) -> Iterator[np.ndarray]:
        arrays = [self._numbers(name) for name in columns]
        for start in range(0, len(arrays[0]), rows):
            yield np.stack([array[start : start + rows].astype(np.float64) for array in arrays])

    def _numbers(self, name: str) -> np.ndarray:
        if name not in self._arrays:
            self._arrays[name] = self._converted(name)
        return self._arrays[name]

    def _converted(self, name: str) -> np.ndarray:
        array = _array(self._given[name], name, self._place)
        if array.dtype.kind in "OUT":
            return self._from_cells(name, array)
        if array.dtype.kind not in "fiu":
            seconds = ", times in seconds" if array.dtype.kind in "mM" else ""
            raise RecordingError(f"{self._place}: column '{name}' holds {array.dtype}; expected numbers{seconds}")
        return array

    def _from_cells(self, name: str, cells: np.ndarray) -> np.ndarray:
        """Return numbers of cells that each have a type; missing ones (None, pandas.NA) become NaN."""
        try:
            return _of_cells(cells)
        except (pa.ArrowException, TypeError):
            for row, cell in enumerate(cells.ravel().tolist(), start=1):
                if not _is_number(cell):
                    raise RecordingError(
                        f"{self._place}: column '{name}', data row {row}: expected a number, got {cell!r:.50}; "
                        "a missing one is nan or None"
                    ) from None
            raise RecordingError(
                f"{self._place}: column '{name}' holds cells of several types; expected numbers"
            ) from None


def _array(values: Any, name: str, place: str) -> np.ndarray:
    """Return an array of any container of numbers, in the same memory if possible.

    Raises:
        RecordingError: it holds no numbers.
    """
    try:
        if isinstance(values, torch.Tensor):
            values = values.detach().cpu()
            return (values.double() if values.dtype == torch.bfloat16 else values).numpy()
        return np.asarray(values.to_numpy() if hasattr(values, "to_numpy") else values)
    except (TypeError, ValueError) as error:
        raise RecordingError(f"{place}: '{name}' is no array: {error}") from None


def _of_cells(cells: np.ndarray) -> np.ndarray:
    numbers = pa.array(cells.ravel(), from_pandas=True).cast(pa.float64())
    return numbers.to_numpy(zero_copy_only=False).reshape(cells.shape)


def _is_number(cell: object) -> bool:
    try:
        _of_cells(np.array([cell], dtype=object))
    except (pa.ArrowException, TypeError):
        return False
    return True


def _unstacked(arrays: Mapping[str, Any], joints: Sequence[str], place: str) -> dict[str, Any]:
    """Return the columns of arrays (N, n) with the names of NPZ files; other arrays keep their names."""
    own = {name: _array(arrays[name], name, place) for name in ("t", *NPZ_SIGNALS) if name in arrays}
    names = [str(name) for name in _array(arrays["joints"], "joints", place)] if "joints" in arrays else list(joints)
    whose = f"the {len(names)} names in 'joints'"
    if "joints" not in arrays:
        whose = f"the robot's {len(names)} joints; name others under 'joints'"
    check_shapes(place, {name: array.shape for name, array in own.items()}, len(names), whose)
    columns = {"t": own["t"]}
    for name in NPZ_SIGNALS:
        if name in own:
            columns |= {f"{name}_{joint}": own[name][:, index] for index, joint in enumerate(names)}
    return columns | {name: value for name, value in arrays.items() if name not in (*own, "joints")}
