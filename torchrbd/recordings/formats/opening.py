"""Open tables of numbers in files and folders of many formats, each read in bounded memory."""

from __future__ import annotations

from functools import lru_cache
from importlib.metadata import entry_points
from pathlib import Path

from torchrbd.errors import RecordingError
from torchrbd.recordings.formats import lerobot, matlab, npz, parquet_files, ros_bags, texts
from torchrbd.recordings.formats.table import Format, Table
from torchrbd.recordings.mapping import Mapping

GROUP = "torchrbd.formats"
"""Entry points of this group are formats that other packages offer, see ``Format``."""
STATISTICS = ".stats"
"""Suffix of files with second moments, which are not tables."""
# Suffixes that messages leave out.
_HARDLY_KNOWN = (".txt", ".tsv", ".db3")
_OWN = (texts, parquet_files, npz, matlab, ros_bags, lerobot)


@lru_cache(maxsize=1)
def formats() -> tuple[Format, ...]:
    """Return all formats, our own first.

    Raises:
        RecordingError: an entry point that is none.
    """
    found = [format for module in _OWN for format in module.FORMATS]
    for point in entry_points(group=GROUP):
        other = point.load()
        if not isinstance(other, Format):
            raise RecordingError(
                f"entry point {point.value!r} of {GROUP}: expected a torchrbd.recordings.Format, got a "
                f"{type(other).__name__}; update or remove the package that has it"
            )
        found.append(other)
    return tuple(found)


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
    suffix = path.suffix.lower()
    if suffix == STATISTICS:
        raise RecordingError(
            f"{path}: holds second moments, not rows; only 'torchrbd identify' takes them, give the recording itself"
        )
    own = next((format for format in formats() if suffix in format.suffixes), None)
    if own is None:
        raise RecordingError(f"{path}: cannot read '{path.suffix}' files; expected {_expected()}")
    if not path.is_file():
        raise RecordingError(f"{path}: no such file; check the path")
    if path.stat().st_size == 0:
        raise RecordingError(f"{path}: the file is empty; leave it out, or record again")
    return own.open(path, mapping)


def _expected() -> str:
    suffixes = [suffix for format in formats() for suffix in format.suffixes if suffix not in _HARDLY_KNOWN]
    return f"{', '.join(suffixes)} or the folder of a ROS 2 bag or LeRobot set"


def _open_folder(path: Path, mapping: Mapping) -> Table:
    for format in formats():
        if format.marker and (path / format.marker).is_file():
            return format.open(path, mapping)
    inside = sorted(entry.name for entry in path.iterdir() if entry.suffix in ros_bags.SUFFIXES)
    if inside:
        raise RecordingError(
            f"{path}: a ROS 2 bag without metadata.yaml, it was not closed: 'ros2 bag reindex {path.name}' writes it, "
            f"or give {path / inside[0]}"
        )
    raise RecordingError(
        f"{path}: a folder, and neither a ROS 2 bag (metadata.yaml) nor a LeRobot data set ({lerobot.INFO}); give "
        "its files one by one"
    )
