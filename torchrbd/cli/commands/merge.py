"""``torchrbd merge``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from torchrbd.cli.parameters import examples, file, value

AFTER = examples(
    "torchrbd merge moments/*.stats -o all.stats",
    "torchrbd identify arm.urdf all.stats -o out",
)


def merge(
    files: Annotated[list[Path], file("STATS", "files that 'torchrbd stats' wrote")],
    /,
    *,
    output: Annotated[Path, value("FILE", "file to write, ending in .stats", short="o")],
) -> None:
    """Add statistics files: one file in place of many."""
    from torchrbd.cli.statistics import merge as work

    work(files, output)
