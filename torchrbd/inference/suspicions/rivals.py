"""Rival explanations of a table that seems to mean something else: they have to be far less likely.

Exchanged columns are two joints' torques that fit each other's place better. The torque of a joint that is not driven,
or of a dead sensor, fits any place as well as its own, and spoils the estimates of its neighbours. The rival is
therefore that one of the two, or both, are not used. Gravity along another axis makes torques that depend on positions,
as springs and cables do: both directions are tried with a spring at every joint.
"""

from __future__ import annotations

from collections.abc import Iterator

from torchrbd.inference.suspicions.explained import Explained
from torchrbd.inference.suspicions.hypotheses import Hypothesis
from torchrbd.inference.suspicions.samples import SPRINGS, Samples
from torchrbd.inference.suspicions.writing import Writing


def rivals(h: Hypothesis, tried: Explained, samples: Samples, now: Writing) -> Iterator[tuple[Explained, Explained]]:
    """Yield explanations of the table as it stands that have to be far less likely, each with what it is held against.

    Args:
        h: the hypothesis.
        tried: what it explains.
        samples: of the table.
        now: how the table is read now.
    """
    if h.is_swap:
        for unread in (*((j,) for j in h.joints), h.joints):
            yield samples.explained(now, unread=unread), tried
    if h.kind == "gravity":
        yield samples.explained(now, further_effects=[SPRINGS]), samples.explained(h.writing, further_effects=[SPRINGS])
