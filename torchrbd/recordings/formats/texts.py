"""Text files: tables with separators, or what ``ros2 topic echo --csv`` prints."""

from __future__ import annotations

from pathlib import Path

from torchrbd.recordings.formats.csv_files import CsvTable
from torchrbd.recordings.formats.ros_echo import EchoTable, is_echo
from torchrbd.recordings.formats.table import Format, Table


def _open(path: Path, _: object) -> Table:
    return EchoTable(path) if is_echo(path) else CsvTable(path)


FORMATS = (Format((".csv", ".txt", ".tsv"), _open),)
