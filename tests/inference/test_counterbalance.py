"""A counterbalance has many shapes that nearly fit: the grid must start the refinement near the right one."""

from __future__ import annotations

import pytest
import torch
from inference.truths import Truth, added_by, recovered

from torchrbd.effects import Site, Term
from torchrbd.effects.counterbalance import Counterbalance


@pytest.mark.parametrize(
    ("spring", "force", "centre"),
    [(0.3067, 0.46148, 0.20944), (0.0941, 0.0692, -0.31416)],
    ids=["in the range of motion", "just outside"],
)
def test_a_light_wrist(spring: float, force: float, centre: float) -> None:
    """With centres 30 degrees apart the refinement ended at a crank ratio of .95 for both."""
    arm, shape = Truth(21), {"dead_centre": centre, "crank_ratio": 0.51}
    term = Term(Counterbalance(), Site(3), torch.tensor([spring, force], dtype=torch.float64), shape)
    (found,) = recovered(arm, [term], added_by(term, arm))
    assert {k: v for k, (v, _) in found.items()} == pytest.approx(term.parameters_by_name(), rel=0.02)
