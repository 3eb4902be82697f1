"""The sum of statistics files, one of which is in memory at a time."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import torch

from torchrbd.dataset.block_statistics import halved, halvings
from torchrbd.dataset.reading import Progress
from torchrbd.inference.statistics.files import read_statistics
from torchrbd.inference.statistics.results import MOST_BLOCKS, Statistics, added


def merged(
    heads: Sequence[Statistics], own: Collection[int] | None = None, progress: Progress = lambda *_: None
) -> Statistics:
    """Return the sum of files, with no more blocks than a fit looks at, or one a recording.

    How often neighbours are merged follows from the heads; then each file is read, merged and put in its place.

    Args:
        heads: of the files, see ``read_head``.
        own: numbers of those that are read; blocks of the others are zero. All if not given.
        progress: called with the stage and the part of it that is done.

    Raises:
        InputError: files that cannot be read, or that were made under different conditions.
    """
    whole = added(heads)
    times = halvings(whole.blocks, MOST_BLOCKS)
    blocks, _ = halved(whole.blocks, (), times)
    shapes = [one.shape[1:] for one in (*whole.moments, whole.torque)]
    sums = [torch.zeros(len(blocks), *shape, dtype=torch.float64) for shape in shapes]
    first = 0
    for k, head in enumerate(heads):
        progress("reading statistics", k / len(heads))
        count = len(halved(head.blocks, (), times)[0])
        if own is None or k in own:
            _put(read_statistics(head.place).halved(times), [one[first : first + count] for one in sums])
        first += count
    return replace(whole, blocks=blocks, moments=tuple(sums[:-1]), torque=sums[-1])


def _put(part: Statistics, into: Sequence[torch.Tensor]) -> None:
    for own, place in zip((*part.moments, part.torque), into, strict=True):
        place.copy_(own)
