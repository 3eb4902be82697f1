"""Drop the terms that a model does not need."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from torchrbd.diagnosis.rows.gain import Gain, gain
from torchrbd.diagnosis.rows.regression import Fit
from torchrbd.diagnosis.rows.white_rows import Colour, Rows
from torchrbd.diagnosis.search.grid import refined
from torchrbd.diagnosis.search.options import OFFSET, UNEVEN, accepted, instead, least_gain, matters, plausible
from torchrbd.diagnosis.search.steps import Steps
from torchrbd.diagnosis.search.terms import Terms, without
from torchrbd.diagnosis.search.unnamed import is_smooth
from torchrbd.likelihood.columns import Candidate

PARTS_OF_UNEVEN = ("coulomb_friction", OFFSET)


def pruned(search: Steps, fit: Fit) -> Fit:
    """Drop terms, one at a time, that the left-out blocks do not accept or the physics does not allow.

    In the place of a name stands plain friction at its joint, which every robot has: the name must be worth more.
    Friction at every joint is not asked for what it explains beyond drift: it stays where the errors as they are
    tell it, coloured though they be.
    """
    plain = Rows(fit.rows.samples, search.prior, _uncoloured(fit))
    while fit.terms:
        rest = {c: _adapted(fit, plain_instead(search, fit.terms, c), c.place) for c in fit.terms}
        worth = {c: _lost(fit, instead(fit, r, c)) for c, r in rest.items()}
        sound = [c for c in fit.terms if _allowed(search, c) and plausible(fit, c) and not _trifle(fit, c)]
        idle = [c for c in fit.terms if c not in sound or not accepted(worth[c], least_gain(c))]
        normal = [c for c in idle if c in search.background and c in sound]
        if normal:
            raw = Fit(plain, fit.terms)
            idle = [c for c in idle if c not in normal or not accepted(_lost(raw, Fit(plain, rest[c])))]
        if not idle:
            break
        fit = Fit(fit.rows, rest[min(idle, key=lambda c: worth[c].total)]).renoised()
    return joined(search, fit)


def _allowed(search: Steps, term: Candidate) -> bool:
    """Say whether the user lets a term be found; the background stands in the way of others even if not."""
    sites = search.start.rows.samples.columns.sites
    known = is_smooth(term) or term.effect.id in {e.id for e in search.effects}
    site = replace(term.site, recordings=None)
    return known and site in sites.get(term.effect.id, (site,))


def _trifle(fit: Fit, term: Candidate) -> bool:
    """Say whether a term is an offset that does not matter: errors of other terms leave some constant torque."""
    return term.effect.id == OFFSET and not matters(fit, term)


def plain_instead(search: Steps, terms: Terms, left_out: Candidate) -> Terms:
    """Return terms without one, with the plain friction at its joint that is missing."""
    rest = without(terms, left_out)
    if left_out in search.background or left_out.place is None:
        return rest
    return (*(c for c in search.restored(rest) if c.place == left_out.place and c not in rest), *rest)


def _adapted(fit: Fit, terms: Terms, place: int | None) -> Terms:
    """Return terms with the shapes that fit best at a joint, now that one is missing there."""
    for term in terms:
        if term.place == place and term.shape and not is_smooth(term):
            changed = refined(Fit(fit.rows, without(terms, term)), term)
            terms = tuple(changed if c is term else c for c in terms)
    return terms


def joined(search: Steps, fit: Fit) -> Fit:
    """Return a fit in which Coulomb friction and an offset smaller than it are friction that is uneven.

    In motion the two say the same; friction that depends on the direction is the more common.
    """
    terms = fit.terms
    for uneven in search.grid.candidates:
        if uneven.effect.id != UNEVEN:
            continue
        here = [c for c in terms if c.place == uneven.place and c.site.always]
        parts = [c for c in here if c.effect.id in PARTS_OF_UNEVEN]
        if len(parts) == len(PARTS_OF_UNEVEN):
            joined = (*(c for c in terms if c not in parts), uneven)
            terms = joined if plausible(Fit(fit.rows, joined), uneven) else terms
    return Fit(fit.rows, terms)


def _lost(fit: Fit, rest: Fit) -> Gain:
    """Return what a fit gains over another on the same samples."""
    return gain(rest.errors, fit.errors, fit.rows.counts)


def _uncoloured(fit: Fit) -> Colour:
    """Return noise without colour, as large as what a fit leaves."""
    left, weight = fit.leftover(), fit.rows.samples.weight
    scale = np.sqrt(((left * weight) ** 2).sum(1) / np.maximum((weight**2).sum(1), 1e-300))
    return np.zeros_like(fit.rows.noise[0]), np.where(scale > 0, scale, 1.0)
