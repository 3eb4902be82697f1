"""Training, validation and test time: whole windows, with gaps between them.

Samples near in time are alike: with a random split a network would be judged on samples that it has learnt. The time
of all recordings, one after the other, is cut into equal rounds. Each round is first for training, then for validation,
then for test. The gap between two parts is as long as the filters reach.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal

import torch
from torch import Tensor

from torchrbd.errors import OptionError, RecordingError

Split = Literal["train", "validation", "test"]
SPLITS = ("train", "validation", "test")

FRACTIONS = (0.7, 0.15, 0.15)
# The shortest part lasts as many gaps in a round.
_GAPS_A_PART = 3.0


def split_rows(t: Tensor, recording: Tensor, fractions: Sequence[float], gap_s: float) -> Tensor:
    """Return the part that each sample belongs to, (N,) index into SPLITS, -1 in gaps.

    Args:
        t: (N,) seconds from the recording's start, increasing in each.
        recording: (N,) index of the recording, increasing.
        fractions: of the time for each of SPLITS; zero for none.
        gap_s: left out between two parts [s].

    Raises:
        OptionError: fractions that are none.
        RecordingError: so little time that a part would be empty.
    """
    check_fractions(fractions)
    label = torch.full((len(t),), -1, dtype=torch.long)
    passed, begin = torch.zeros_like(t), 0.0
    for k in recording.unique().tolist():
        own = recording == k
        passed[own] = begin + t[own] - t[own].min()
        begin = float(passed[own].max()) + gap_s
    least = min(f for f in fractions if f > 0)
    rounds = max(1, math.floor(begin * least / (_GAPS_A_PART * gap_s)))
    length, ends = begin / rounds, torch.cumsum(torch.tensor([0.0, *fractions], dtype=t.dtype), 0)
    phase = passed % length
    for k in range(len(SPLITS)):
        low, high = float(ends[k]) * length, float(ends[k + 1]) * length
        # The last part's end is the next round's begin.
        alone = fractions[k] == 1.0
        inside = (phase >= low) & (phase < high) if k < 2 else (phase >= low)
        far = (phase - low >= 0.5 * gap_s) & (high - phase >= 0.5 * gap_s)
        if fractions[k] > 0:
            label[inside & (far | alone)] = k
    empty = [name for k, name in enumerate(SPLITS) if fractions[k] > 0 and not (label == k).any()]
    if empty:
        raise RecordingError(
            f"{begin:.3g} s are too little to split: with gaps of {gap_s:.2g} s nothing is left for "
            f"{', '.join(empty)}; record more, or set its fraction to 0"
        )
    return label


def check_fractions(fractions: Sequence[float]) -> None:
    """Raise OptionError unless there are three fractions of zero or more, the first above it, that add to one."""
    if len(fractions) != 3 or not min(fractions) >= 0 or not fractions[0] > 0 or abs(sum(fractions) - 1.0) > 1e-6:
        raise OptionError(
            f"fractions are {tuple(fractions)}; expected three of 0 or more that add to 1, as {FRACTIONS}, of which "
            "some is to train with"
        )
