"""Which blocks are held out: no fit sees them, all models are judged on them."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from itertools import count

import torch
from torch import Tensor

from torchrbd.dataset.block_statistics import Block
from torchrbd.dataset.reading import Reading
from torchrbd.errors import RecordingError
from torchrbd.inference.settings import Settings
from torchrbd.recordings import Recording

_LEAST_BLOCKS = 6

# Neighbouring blocks that are held out together: fewer seams between what is fitted and what is judged.
_RUN = 2


def held_out_blocks(
    blocks: Sequence[Block], recordings: Sequence[Recording], reading: Reading, settings: Settings
) -> tuple[Tensor, str]:
    """Choose the blocks to keep back, and see that enough are left.

    Args:
        blocks: (B,) of all recordings.
        recordings: those that are held out as a whole.
        reading: how recordings are read.
        settings: what the user asked for.

    Returns:
        (B,) bool, and the same for a person.

    Raises:
        RecordingError: too little is left to fit, or nothing that is held out moves.
    """
    runs = None if settings.holdout else (settings.holdout_fraction, settings.seed)
    if runs is None:
        _check_judges(reading, range(len(reading.recordings) - len(recordings), len(reading.recordings)))
        held_out, words = held_out_recordings(blocks, [r.name for r in recordings])
    else:
        held_out, words = held_out_runs(blocks, *runs)
    check_enough(held_out, words, reading.block_s, reading.filtering.cutoff_hz, runs)
    return held_out, words


def _check_judges(reading: Reading, held_out: Sequence[int]) -> None:
    """Refuse to judge by recordings that show no motion, or no torque that changes."""
    if not any(bool(reading.measured(k).any()) and not reading.surveys[k].at_rest for k in held_out):
        names = ", ".join(reading.recordings[k].name for k in held_out)
        raise RecordingError(
            f"nothing moves in what is held out ({names}), or no torque changes there, so that it judges no model; "
            "hold out others, or none: a part of each recording is held out then"
        )


def held_out_recordings(blocks: Sequence[Block], names: Collection[str]) -> tuple[Tensor, str]:
    """Keep back whole recordings: (B,) bool, and the same for a person."""
    return torch.tensor([block.recording in names for block in blocks], dtype=torch.bool), ", ".join(sorted(names))


def held_out_runs(blocks: Sequence[Block], fraction: float, seed: int) -> tuple[Tensor, str]:
    """Keep back a part of all blocks, in short runs.

    Args:
        blocks: (B,) in the order of the recordings.
        fraction: to keep back, (0, 0.5].
        seed: where the first run is.

    Returns:
        (B,) bool, and the same for a person.
    """
    held = _runs(len(blocks), fraction, seed)
    kept = [k for k, one in enumerate(held.tolist()) if one]
    # A run ends where blocks are fitted, or another recording begins.
    starts = [k for k in kept if k - 1 not in kept or blocks[k - 1].recording != blocks[k].recording]
    ends = [k for k in kept if k + 1 not in kept or blocks[k + 1].recording != blocks[k].recording]
    share = f"{100 * len(kept) / max(len(blocks), 1):.0f} % of the time"
    if len(starts) == 1:
        first, last = blocks[starts[0]], blocks[ends[0]]
        return held, f"{share}, {first.start_s:.3g} to {last.end_s:.3g} s of {first.recording}"
    longest = max((blocks[b].end_s - blocks[a].start_s for a, b in zip(starts, ends, strict=True)), default=0.0)
    return held, f"{share}, in {len(starts)} runs of up to {longest:.2g} s"


def check_enough(held: Tensor, words: str, block_s: float, cutoff_hz: float, runs: tuple[float, int] | None) -> None:
    """Refuse recordings that leave too little to fit, and say how much more is needed.

    Args:
        held: (B,) bool, held-out blocks.
        words: the same for a person.
        block_s: length of a block [s].
        cutoff_hz: of the filters.
        runs: fraction and seed of ``held_out_runs``; None where whole recordings are held out.
    """
    n_training = int((~held).sum())
    if n_training >= _LEAST_BLOCKS:
        return
    more = _LEAST_BLOCKS - n_training
    if runs is not None:
        more = next(k for k in count(1) if int((~_runs(len(held) + k, *runs)).sum()) >= _LEAST_BLOCKS)
    raise RecordingError(
        f"after filtering at {cutoff_hz:g} Hz and holding out {words}, {n_training} blocks of {block_s:.2g} s are left "
        f"to fit; at least {_LEAST_BLOCKS} are needed: record about {math.ceil(more * block_s)} s more, or give more "
        "recordings"
    )


def _runs(n_blocks: int, fraction: float, seed: int) -> Tensor:
    period = max(2, round(_RUN / fraction))
    run = min(_RUN, period // 2)
    # Counted through all recordings; of very few blocks at least the last is held out.
    held = (torch.arange(n_blocks) + seed * run) % period >= period - run
    if not held.any():
        held[-run:] = True
    return held
