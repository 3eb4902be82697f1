"""A fingerprint of a recording's content."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from pathlib import Path

from torchrbd.recordings.formats import lerobot, ros_bags

_PIECE = 1 << 20


def digest(path: Path) -> tuple[int, str]:
    """Return size [bytes] and SHA-256 of a file, or of the files of a folder that are read, with their names."""
    found, size = hashlib.sha256(), 0
    for file in _files(path):
        if file != path:
            found.update(f"{file.relative_to(path).as_posix()}\0".encode())
        for piece in _pieces(file):
            found.update(piece)
            size += len(piece)
    return size, found.hexdigest()


def _files(path: Path) -> list[Path]:
    """Return the files that are read of a LeRobot data set or a ROS bag, without images and notes; a file is itself."""
    if not path.is_dir():
        return [path]
    return lerobot.files(path) if (path / lerobot.INFO).is_file() else ros_bags.files(path)


def _pieces(file: Path) -> Iterator[bytes]:
    with file.open("rb") as content:
        while piece := content.read(_PIECE):
            yield piece
