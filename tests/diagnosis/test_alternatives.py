"""How many times as probable a rival is, from left-out errors."""

from __future__ import annotations

import numpy as np
import pytest

from torchrbd.diagnosis.alternatives import rival_odds
from torchrbd.diagnosis.rows.gain import gain

BLOCKS, COUNTS = 20, np.array([2000])


def errors(better: float, scatter: float) -> np.ndarray:
    """Return left-out errors (B, 1) that are lower than one by a part, scattered over the blocks."""
    return 1.0 - better + scatter * np.random.default_rng(3).standard_normal((BLOCKS, 1))


def test_a_lead_that_the_blocks_support_counts_for_both_alike() -> None:
    ahead, behind = errors(0.02, 0.001), errors(0.0, 0.0)
    assert gain(behind, ahead, COUNTS).t > 5
    assert rival_odds(ahead, behind, COUNTS, 0.0) > 1e5
    assert rival_odds(behind, ahead, COUNTS, 0.0) < 1e-5


@pytest.mark.parametrize("freedom", [0.0, 3.0])
def test_a_lead_of_chance_decides_for_neither(freedom: float) -> None:
    ahead, behind = errors(0.02, 0.4), errors(0.0, 0.0)
    lead = gain(behind, ahead, COUNTS)
    assert lead.total > 10
    assert lead.t < 1
    forward, backward = (rival_odds(a, b, COUNTS, freedom) for a, b in ((ahead, behind), (behind, ahead)))
    assert np.exp(-freedom) < forward < 2 * np.exp(-freedom)
    assert backward == pytest.approx(np.exp(-2 * freedom) / forward)
