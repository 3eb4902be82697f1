"""Stream NPZ files row by row, so that the arrays are never in memory as a whole."""

from __future__ import annotations

import zipfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import numpy as np

from torchrbd.errors import RecordingError
from torchrbd.recordings.formats.table import Format

# Largest array of joint names [bytes]; numbers are streamed and have no limit.
_LARGEST_NAMES = 1 << 22
NPZ_SIGNALS = ("q", "tau", "qd", "qdd", "q_ref", "q_link", "temperature")


@dataclass(frozen=True)
class _Array:
    """Position of an array in an NPZ file."""

    member: str
    shape: tuple[int, ...]


class NpzTable:
    """Stream the arrays of an NPZ file.

    `t (N,)`, `q`, `tau`, optional `qd`, `qdd`, `q_ref`, `q_link`, `temperature` `(N, n)` and `joints (n,)`. The arrays
    are decompressed row by row, so the file is never in memory as a whole.
    """

    def __init__(self, path: Path):
        self.path = path
        try:
            with zipfile.ZipFile(path) as archive:
                members = {name.removesuffix(".npy"): name for name in archive.namelist()}
                self._arrays = {}
                for name in ("t", *NPZ_SIGNALS):
                    if name in members:
                        with archive.open(members[name]) as stream:
                            self._arrays[name] = _Array(members[name], _read_npy_header(stream, path, name)[0])
            if "joints" not in members:
                raise RecordingError(f"{path}: the array 'joints' with the joints' names is missing")
            with zipfile.ZipFile(path) as archive:
                size = archive.getinfo(members["joints"]).file_size
            if size > _LARGEST_NAMES:
                raise RecordingError(f"{path}: the array 'joints' takes {size} bytes; expected the joints' names")
            with np.load(path, allow_pickle=False) as arrays:
                joints = [str(name) for name in np.atleast_1d(arrays["joints"])]
        except (zipfile.BadZipFile, ValueError, EOFError) as error:
            if isinstance(error, RecordingError):
                raise
            raise RecordingError(f"{path}: not a readable NPZ file: {error}") from None
        shapes = {name: array.shape for name, array in self._arrays.items()}
        check_shapes(str(path), shapes, len(joints), f"the {len(joints)} names in 'joints'")
        self._slots = {"t": ("t", 0)}
        for name in NPZ_SIGNALS:
            if name in self._arrays:
                self._slots |= {f"{name}_{joint}": (name, index) for index, joint in enumerate(joints)}
        self.columns = tuple(self._slots)

    def batches(self, columns: Sequence[str], rows: int) -> Iterator[np.ndarray]:
        names = list(dict.fromkeys(self._slots[column][0] for column in columns))
        with zipfile.ZipFile(self.path) as archive:
            streams = [_stream_npy(archive.open(self._arrays[name].member), self.path, name, rows) for name in names]
            for blocks in zip(*streams, strict=True):
                block = dict(zip(names, blocks, strict=True))
                yield np.stack([block[name][:, index] for name, index in (self._slots[c] for c in columns)])


def check_shapes(place: str, shapes: Mapping[str, tuple[int, ...]], n_joints: int, whose: str) -> None:
    """Check arrays t (N,) and others (N, n).

    Args:
        place: file or name, for messages.
        shapes: by name.
        n_joints: n.
        whose: the joints, for messages.

    Raises:
        RecordingError: there is no t, or a shape does not fit.
    """
    if "t" not in shapes:
        raise RecordingError(f"{place}: the array 't' with the times is missing; present: {', '.join(shapes)}")
    length = shapes["t"][0] if shapes["t"] else 0
    for name, shape in shapes.items():
        expected = (length,) if name == "t" else (length, n_joints)
        if shape != expected:
            raise RecordingError(
                f"{place}: array '{name}' has shape {shape}; expected {expected} for {length} times and {whose}"
            )


def _read_npy_header(stream: IO[bytes], path: Path, name: str) -> tuple[tuple[int, ...], bool, np.dtype]:
    version = np.lib.format.read_magic(stream)
    read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, fortran, dtype = read(stream)
    if dtype.kind not in "fiu":
        raise RecordingError(f"{path}: array '{name}' holds {dtype}; expected numbers")
    return shape, fortran, dtype


def _stream_npy(stream: IO[bytes], path: Path, name: str, rows: int) -> Iterator[np.ndarray]:
    """Yield blocks (at most `rows`, columns) of an array in NPY format."""
    with stream:
        shape, fortran, dtype = _read_npy_header(stream, path, name)
        length, width = shape[0], shape[1] if len(shape) > 1 else 1
        if fortran and width > 1:  # stored column by column: rows cannot be streamed
            whole = np.frombuffer(stream.read(), dtype).reshape(width, length).T.astype(np.float64)
            for start in range(0, length, rows):
                yield whole[start : start + rows]
            return
        for start in range(0, length, rows):
            count = min(rows, length - start) * width
            data = stream.read(count * dtype.itemsize)
            if len(data) < count * dtype.itemsize:
                raise RecordingError(f"{path}: array '{name}' ends early: damaged file")
            yield np.frombuffer(data, dtype).reshape(-1, width).astype(np.float64)


FORMATS = (Format((".npz",), lambda path, _: NpzTable(path)),)
