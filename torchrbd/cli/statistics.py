"""Statistics files: make them, one process or several that torchrun has started, and add them."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console

from torchrbd.cli.progress import progress_bar
from torchrbd.cli.settings import settings_of
from torchrbd.errors import OptionError
from torchrbd.inference.statistics.folder import merge_statistics, write_statistics
from torchrbd.outputs import OutputFolder
from torchrbd.ranks import Ranks, ranks
from torchrbd.recordings.formats import STATISTICS


def stats(options: argparse.Namespace) -> None:
    """Make a statistics file of each recording."""
    settings = settings_of(options)
    _check_ending(options.merge)
    with (
        ranks() as own,
        _folder(options, own),
        progress_bar(time_left=True, shown=own.first, quiet=options.quiet) as progress,
    ):
        files = write_statistics(
            options.robot, options.recordings, options.output, merged=options.merge, ranks=own, progress=progress,
            **settings,
        )  # fmt: skip
        if own.first:
            also = f", and their sum to {options.merge}" if options.merge else ""
            written = "1 statistics file" if len(files) == 1 else f"{len(files)} statistics files"
            _say(f"wrote {written} to {options.output}{also}")


def merge(options: argparse.Namespace) -> None:
    """Add statistics files."""
    _check_ending(options.output)
    found = merge_statistics(options.files, options.output)
    hours = sum(one.duration_s for one in found.origins) / 3600
    _say(f"wrote {options.output}: {len(found.origins)} recordings, {hours:.3g} hours, in {len(found.blocks)} blocks")


@contextmanager
def _folder(options: argparse.Namespace, own: Ranks) -> Iterator[None]:
    """Hold the folder: one run at a time, whose first process stands for all."""
    if own.first:
        with OutputFolder(options.output):
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
