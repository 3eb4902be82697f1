"""Loads and forces in stretches of time that touch: one load for the whole of them, where it does as well."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

from torchrbd.diagnosis.rows.gain import gain
from torchrbd.diagnosis.rows.regression import Fit
from torchrbd.diagnosis.search.options import clearly_worse, judged, plausible, preferred, takes
from torchrbd.diagnosis.search.steps import Steps
from torchrbd.diagnosis.search.terms import Terms
from torchrbd.diagnosis.search.unnamed import is_smooth
from torchrbd.physics import Window

# Between stretches that touch is a gap of less than this part of the shorter one.
GAP = 0.1


def with_joined(search: Steps, fit: Fit) -> Terms:
    """Return a fit's terms, one load or force in place of two in stretches that touch, unless the two are better."""
    loads = [(c, c.site.window) for c in fit.terms if c.site.window is not None and not is_smooth(c)]
    columns = fit.rows.samples.columns
    for (a, first), (b, second) in combinations(loads, 2):
        whole = _union(first, second)
        if whole is None:
            continue
        rest = Fit(fit.rows, tuple(c for c in fit.terms if c not in (a, b)))
        offered = [columns.candidate(c.effect, replace(c.site, window=whole), c.shape) for c in (a, b)]
        options = [judged(rest, c) for c in search.possible(offered) if plausible(rest, c)]
        options = [o for o in options if takes(o)]
        if not options:
            continue
        one = preferred(rest, options)
        if not clearly_worse(gain(one.errors, fit.errors, fit.rows.counts), one.worth.total):
            return (*rest.terms, one.candidate)
    return fit.terms


def _union(a: Window, b: Window) -> Window | None:
    """Return the stretch that two which touch are together; None of others."""
    shorter = min(a.end_s - a.start_s, b.end_s - b.start_s)
    if a.recording != b.recording or max(a.start_s, b.start_s) - min(a.end_s, b.end_s) > GAP * shorter:
        return None
    return Window(a.recording, min(a.start_s, b.start_s), max(a.end_s, b.end_s))
