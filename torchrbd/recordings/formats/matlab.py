"""Read arrays from MATLAB files: versions 4 to 7 with scipy, 7.3, which is HDF5, with h5py."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy import io as scipy_io

from torchrbd.errors import RecordingError
from torchrbd.recordings.extras import needed
from torchrbd.recordings.formats.npz import NPZ_SIGNALS
from torchrbd.recordings.formats.table import Format

_HDF5 = b"\x89HDF\r\n\x1a\n"
_MOST_NAMES, _LONGEST_NAME, _DEEPEST = 1000, 256, 3
# Largest variable in a file that is read as a whole: 2 GB of doubles.
_MOST_NUMBERS = 1 << 28
_TABLES = (
    "tables, timetables and strings are MATLAB's own objects: save s = table2struct(T, 'ToScalar', true) and "
    "cellstr(names) instead"
)

_Slot = tuple[str, int, bool]
"""Of a column: the variable, its index in it, and whether it is a row of the stored array."""


@dataclass(frozen=True)
class _Variable:
    """A numeric variable: its shape in MATLAB (rows, columns), and whether the file stores it transposed."""

    shape: tuple[int, int]
    transposed: bool = False


class MatTable:
    """Stream the vectors and matrices of a MATLAB file.

    `t (N,)`, `q`, `tau`, optional `qd`, `qdd`, `q_ref`, `q_link`, `temperature` `(N, n)` and the joints' names in
    `joints`, a cell array or a matrix of letters. Other vectors of N are columns with their names, other matrices
    `name[0]`, `name[1]`, and so on. Fields of a structure are `structure.field`, or just `field` if nothing else is in
    the file. Files of version 7.3 are streamed, earlier ones read as a whole.
    """

    def __init__(self, path: Path):
        self.path = path
        with path.open("rb") as file:
            head = file.read(520)
        self._streamed = _HDF5 in (head[:8], head[512:520])
        if self._streamed:
            with self._opened() as file:
                found = dict(_datasets(file))
                variables = {name: _hdf5_variable(data) for name, data in found.items() if _hdf5_is_numeric(data)}
                names = _hdf5_names(file, found["joints"]) if "joints" in found else None
        else:
            arrays = _loaded(path)
            self._arrays = {name: array for name, array in arrays.items() if _is_numeric(array)}
            variables = {name: _Variable(array.shape) for name, array in self._arrays.items()}
            names = _names(arrays["joints"]) if "joints" in arrays else None
        self._slots = self._columns_of(variables, names)
        self.columns = tuple(self._slots)

    def batches(self, columns: Sequence[str], rows: int) -> Iterator[np.ndarray]:
        with self._opened() as file:
            data = dict(_datasets(file)) if self._streamed else self._arrays
            for start in range(0, self._length, rows):
                end = min(start + rows, self._length)
                block, read = np.empty((len(columns), end - start)), {}
                for row, column in enumerate(columns):
                    name, index, upright = self._slots[column]
                    if name not in read:
                        part = data[name][start:end] if upright else data[name][:, start:end].T
                        read[name] = np.asarray(part, dtype=np.float64).reshape(end - start, -1)
                    block[row] = read[name][:, index]
                yield block

    @contextmanager
    def _opened(self) -> Iterator[Any]:
        if not self._streamed:
            yield None
            return
        h5py = needed("h5py", "matlab", self.path)
        try:
            with h5py.File(self.path, "r") as file:
                yield file
        except RecordingError:
            raise
        except Exception as error:  # damaged files fail anywhere in the library, in any way
            raise RecordingError(f"{self.path}: not a readable MATLAB file: {error}") from None

    def _columns_of(self, variables: dict[str, _Variable], joints: list[str] | None) -> dict[str, _Slot]:
        """Return, by column, the variable, its index in it, and whether it is a row of the stored array."""
        if not variables:
            raise RecordingError(f"{self.path}: holds no vectors or matrices of numbers; {_TABLES}")
        self._length = max(variables["t"].shape if "t" in variables else (max(v.shape) for v in variables.values()))
        slots: dict[str, _Slot] = {}
        for name, variable in variables.items():
            if self._length not in variable.shape:
                if name in NPZ_SIGNALS:
                    raise RecordingError(
                        f"{self.path}: array '{name}' has shape {variable.shape}; expected {self._length} rows, one "
                        "for each time"
                    )
                continue
            along = variable.shape.index(self._length)
            width = variable.shape[1 - along]
            upright = (along == 0) != variable.transposed
            if name in NPZ_SIGNALS and joints is not None:
                if len(joints) != width:
                    raise RecordingError(
                        f"{self.path}: array '{name}' has {width} columns; expected {len(joints)}, one for each of the "
                        "names in 'joints'"
                    )
                keys = [f"{name}_{joint}" for joint in joints]
            else:
                keys = [name] if width == 1 else [f"{name}[{index}]" for index in range(width)]
            slots |= {key: (name, index, upright) for index, key in enumerate(keys)}
        return slots


def _is_numeric(array: Any) -> bool:
    return isinstance(array, np.ndarray) and array.dtype.kind in "fiu" and array.ndim == 2 and array.size > 1


def _loaded(path: Path) -> dict[str, Any]:
    """Return the variables of a file before version 7.3; those in structures by dotted names."""
    try:
        for name, shape, _ in scipy_io.whosmat(str(path), appendmat=False):
            if np.prod(np.array(shape, dtype=float)) > _MOST_NUMBERS:
                raise RecordingError(
                    f"{path}: array '{name}' has shape {shape}, too much to be read at once; save the file with "
                    "'-v7.3', which is read in pieces"
                )
        content = scipy_io.loadmat(str(path), appendmat=False)
    except RecordingError:
        raise
    except Exception as error:  # damaged files fail anywhere in the library, in any way
        raise RecordingError(f"{path}: not a readable MATLAB file: {error}") from None
    found = dict(_unfolded({name: value for name, value in content.items() if not name.startswith("__")}, "", 0))
    return _bare(found)


def _unfolded(content: dict[str, Any], prefix: str, depth: int) -> Iterator[tuple[str, Any]]:
    for name, value in content.items():
        if not isinstance(value, np.ndarray):
            continue
        fields = value.dtype.names
        if fields and value.size == 1 and depth < _DEEPEST:
            yield from _unfolded({field: value.flat[0][field] for field in fields}, f"{prefix}{name}.", depth + 1)
        elif not fields:
            yield f"{prefix}{name}", value


def _bare(found: dict[str, Any]) -> dict[str, Any]:
    """Remove the structure's name if all variables are in one."""
    while len(heads := {name.partition(".")[0] for name in found}) == 1 and all("." in name for name in found):
        found = {name[len(next(iter(heads))) + 1 :]: value for name, value in found.items()}
    return found


def _names(array: np.ndarray) -> list[str]:
    """Return text from a cell array of strings or a matrix of letters."""
    cells = [cell.item() if isinstance(cell, np.ndarray) and cell.size == 1 else cell for cell in array.ravel()]
    return [str(cell).strip() for cell in cells]


def _datasets(file: Any) -> Iterator[tuple[str, Any]]:
    """Yield HDF5 data sets by dotted name, without MATLAB's internal ones."""
    found = {}

    def visit(name: str, item: Any) -> None:
        if hasattr(item, "dtype") and not name.startswith("#"):
            found[name.replace("/", ".")] = item

    file.visititems(visit)
    yield from _bare(found).items()


def _hdf5_is_numeric(data: Any) -> bool:
    kind = data.attrs.get("MATLAB_class", b"double")
    usable = data.dtype.kind in "fiu" and kind not in (b"char", b"cell", b"logical") and _harmless(data)
    return usable and "MATLAB_empty" not in data.attrs and data.ndim in (1, 2) and data.size > 1


def _harmless(data: Any) -> bool:
    """Return whether a data set is in the file itself, in pieces that can be read one at a time."""
    return not data.is_virtual and not data.external and np.prod(data.chunks or (1,), dtype=float) <= _MOST_NUMBERS


def _hdf5_variable(data: Any) -> _Variable:
    rows, columns = data.shape if data.ndim == 2 else (data.shape[0], 1)
    if "MATLAB_class" in data.attrs:  # MATLAB counts along columns, HDF5 along rows
        return _Variable((columns, rows), transposed=True)
    return _Variable((rows, columns))


def _hdf5_names(file: Any, data: Any) -> list[str]:
    """Return text from a cell array of strings, a matrix of letters, or HDF5's own strings."""
    if not _harmless(data) or data.size > _MOST_NAMES * _LONGEST_NAME:
        raise RecordingError(f"{file.filename}: 'joints' has {data.size} elements; expected the joints' names")
    values = data[()]
    if data.dtype.kind == "O" and data.attrs.get("MATLAB_class") == b"cell":
        cells = [file[one] for one in values.ravel()]
        if all(_harmless(cell) and cell.dtype.kind == "u" and cell.size <= _LONGEST_NAME for cell in cells):
            return ["".join(map(chr, cell[()].ravel())).strip() for cell in cells]
        raise RecordingError(f"{file.filename}: 'joints' is no cell array of names; save cellstr(names)")
    if data.dtype.kind == "u":  # (letters, joints)
        return ["".join(map(chr, letters)).strip() for letters in values.T]
    return [one.decode() if isinstance(one, bytes) else str(one) for one in np.ravel(values)]


FORMATS = (Format((".mat",), lambda path, _: MatTable(path)),)
