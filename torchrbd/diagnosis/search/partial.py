"""Add what acts for a time, or in some recordings only."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from torchrbd.diagnosis.locate import stretches
from torchrbd.diagnosis.locate.search import common_noise
from torchrbd.diagnosis.rows.gain import gain
from torchrbd.diagnosis.rows.regression import Fit, fitted
from torchrbd.diagnosis.rows.white_rows import Rows
from torchrbd.diagnosis.search.grid import Grid, candidates
from torchrbd.diagnosis.search.joining import with_joined
from torchrbd.diagnosis.search.options import Option, clearly_worse, judged, preferred, takes
from torchrbd.diagnosis.search.recordings import recordings, screened_by_recordings
from torchrbd.diagnosis.search.steps import Steps
from torchrbd.diagnosis.search.terms import Terms, names, without
from torchrbd.diagnosis.search.unnamed import is_smooth
from torchrbd.physics import Window

MOST_WINDOWED, MOST_PARTIAL = 3, 10


def partial(search: Steps, fit: Fit) -> Fit:
    """Add what acts in some recordings only, and loads and forces for a time that the leftover shows.

    Of what one recording shows the others say nothing: parts of each are left out, not whole ones.
    """
    started = fit
    if len(recordings(fit.rows.samples)) > 1:
        samples = replace(fit.rows.samples, whole_folds=False)
        fit = Fit(Rows(samples, search.prior, fit.rows.noise), fit.terms)
    visited = {frozenset(names(fit.terms))}
    for number in range(MOST_PARTIAL):
        clear = _uncovered(search, fit)
        windowed = in_windows(search, fit, stretches(fit), clear) if number < MOST_WINDOWED else []
        options = [o for o in (*windowed, *search.in_some_recordings(fit, clear)) if takes(o)]
        changed = (*fit.terms, preferred(fit, options).candidate) if options else _not_common(search, fit)
        if changed is None:
            break
        settled = search.settled(fitted(fit.rows.samples, search.prior, changed, fit.rows.noise))
        joined = with_joined(search, settled)
        if joined is not settled.terms:
            settled = fitted(settled.rows.samples, search.prior, joined, settled.rows.noise)
        settled = search.named(settled)
        if frozenset(names(settled.terms)) in visited:
            break
        fit = settled
        visited.add(frozenset(names(fit.terms)))
        search.report(fit.terms)
    return fit if len(visited) > 1 else started


def _uncovered(search: Steps, fit: Fit) -> Fit:
    """Return a fit with the noise beside what some recordings seem to have.

    A level that one of them has makes the noise look like drift, which hides it.
    """
    samples = fit.rows.samples
    if len(recordings(samples)) == 1:
        return fit
    shared = Fit(Rows(samples, search.prior, common_noise(fit)), fit.terms)
    best = next(iter(screened_by_recordings(search.grid, shared)), None)
    if best is None or best.score <= 0:
        return fit
    beside = Fit(shared.rows, (*fit.terms, best.candidate))
    return Fit(Rows(samples, search.prior, beside.noise()), fit.terms)


def _not_common(search: Steps, fit: Fit) -> Terms | None:
    """Return terms with one for some recordings in the place of one for all that is clearly worse; None without."""
    for term in fit.terms if len(recordings(fit.rows.samples)) > 1 else ():
        if term in search.background or is_smooth(term) or not term.site.always:
            continue
        rest = Fit(fit.rows, search.restored(without(fit.terms, term))).renoised()
        own = judged(rest, term)
        for option in search.in_some_recordings(rest):
            lead = gain(own.errors, option.errors, fit.rows.counts)
            if takes(option) and clearly_worse(lead, option.worth.total):
                return (*rest.terms, option.candidate)
    return None


def in_windows(search: Steps, fit: Fit, windows: Sequence[Window], clear: Fit | None = None) -> list[Option]:
    """Return loads and forces in stretches of time, in a clearer view of the same fit if given."""
    timed = [e for e in search.effects if e.sites(search.robot, (Window(""),)) and not e.sites(search.robot)]
    if not timed or not windows:
        return []
    samples = fit.rows.samples
    offered = candidates(samples.columns, timed, samples.seen, windows)
    return search.shortlisted(fit, Grid(samples, search.possible(offered)).screened(clear or fit))
