"""Statistics files: make them, one process or several that torchrun has started, and add them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rich.console import Console

from torchrbd._runtime.outputs import OutputFolder
from torchrbd._runtime.ranks import Ranks, ranks
from torchrbd.cli.progress import progress_bar
from torchrbd.errors import OptionError
from torchrbd.inference.statistics.folder import merge_statistics, write_statistics
from torchrbd.recordings.formats.opening import STATISTICS
from torchrbd.report.text.console import wrote_statistics, wrote_sum


def stats(
    robot: Path, recordings: Sequence[Path], output: Path, merged: Path | None, options: Mapping[str, Any], quiet: bool
) -> None:
    """Make a statistics file of each recording."""
    _check_ending(merged)
    with (
        ranks() as own,
        _folder(output, own),
        progress_bar(time_left=True, shown=own.first, quiet=quiet) as progress,
    ):
        files = write_statistics(robot, recordings, output, merged=merged, ranks=own, progress=progress, **options)
        if own.first:
            _say(wrote_statistics(len(files), output, merged))


def merge(files: Sequence[Path], output: Path) -> None:
    """Add statistics files."""
    _check_ending(output)
    found = merge_statistics(files, output)
    hours = sum(one.duration_s for one in found.origins) / 3600
    _say(wrote_sum(output, len(found.origins), hours, len(found.blocks)))


@contextmanager
def _folder(output: Path, own: Ranks) -> Iterator[None]:
    """Hold the folder: one run at a time, represented by its first process."""
    if own.first:
        with OutputFolder(output):
            own.wait()
            yield
    else:
        own.wait()
        yield


def _check_ending(path: object) -> None:
    if path is not None and not str(path).endswith(STATISTICS):
        raise OptionError(f"'{path}': the name of a statistics file ends in {STATISTICS}, by which 'identify' knows it")


def _say(words: str) -> None:
    Console(highlight=False, soft_wrap=True).print(words, markup=False)
