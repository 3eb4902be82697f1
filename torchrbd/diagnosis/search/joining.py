"""Loads and forces in stretches of time that touch: one load for the whole of them, where it does as well."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations
from typing import TYPE_CHECKING

from torchrbd.diagnosis.rows.gain import gain
from torchrbd.diagnosis.rows.regression import Fit
from torchrbd.diagnosis.search.grid import complexity
from torchrbd.diagnosis.search.options import Option, clearly_worse, judged, plausible, takes
from torchrbd.diagnosis.search.terms import Terms
from torchrbd.inference.data.columns import Candidate
from torchrbd.physics import Window

if TYPE_CHECKING:
    from torchrbd.diagnosis.search.select import Search

# Between stretches that touch is a gap of less than this part of the shorter one.
GAP = 0.1


def with_joined(search: Search, fit: Fit) -> Terms:
    """Return a fit's terms, one load or force in place of two in stretches that touch, unless the two are better."""
    for pair in combinations([c for c in fit.terms if c.site.window is not None], 2):
        whole = _union(pair)
        if whole is None:
            continue
        rest = Fit(fit.rows, tuple(c for c in fit.terms if c not in pair))
        columns = fit.rows.samples.columns
        offered = [columns.candidate(c.effect, replace(c.site, window=whole), c.shape) for c in pair]
        options = [judged(rest, c) for c in search.possible(offered) if plausible(rest, c)]
        best = _best(fit, [o for o in options if takes(o)])
        if best is not None and not clearly_worse(gain(best.errors, fit.errors, fit.rows.counts), best.worth.total):
            return (*rest.terms, best.candidate)
    return fit.terms


def _best(fit: Fit, options: Sequence[Option]) -> Option | None:
    return max(options, key=lambda o: (o.worth.total, -complexity(fit, o.candidate)), default=None)


def _union(pair: tuple[Candidate, ...]) -> Window | None:
    """Return the stretch that two which touch are together; None of others."""
    a, b = (c.site.window for c in pair)
    assert a is not None
    assert b is not None
    shorter = min(a.end_s - a.start_s, b.end_s - b.start_s)
    if a.recording != b.recording or max(a.start_s, b.start_s) - min(a.end_s, b.end_s) > GAP * shorter:
        return None
    return Window(a.recording, min(a.start_s, b.start_s), max(a.end_s, b.end_s))
