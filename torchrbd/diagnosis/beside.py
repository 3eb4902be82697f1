"""Plain friction and offsets that a search has not found, fitted beside what it has.

A robot with friction at some joints has some at all of them. What is too little to be found goes, where it is left out,
into what was found: a constant torque into a payload or the tilt of the base, viscous friction into drag. Values and
intervals are those of the fit with all of it. Friction that would drive its joint, by no more than chance, is none but
stays in the intervals; by more, something else is there that looks like it, and it is left out.
What a term has of a constant torque, as a spring away from its rest position, no motion tells from uneven Coulomb
friction, which is taken to be as uneven as at the other joints.

Source: the bias by an omitted variable, any textbook of regression, e.g. Greene, "Econometric Analysis", sect. 4.3.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import torch

from torchrbd.diagnosis.refuting import allowed
from torchrbd.diagnosis.rows.regression import Fit
from torchrbd.diagnosis.search.grid import fresh_columns
from torchrbd.diagnosis.search.options import BACKGROUND, INSIGNIFICANT, OFFSET, UNEVEN
from torchrbd.diagnosis.search.select import Search
from torchrbd.diagnosis.search.terms import Terms
from torchrbd.inference.physical.fitting import FittedModel
from torchrbd.inference.preparation import Prepared
from torchrbd.inference.shapes.refine import fit_with_shapes
from torchrbd.likelihood.columns import Candidate
from torchrbd.physics.plain_friction import PARTS

# A term of which less than this is left beside others says what they say.
LEAST_SHARE = 1e-3
_SPANNED = 1e-9
CONSTANT = "1"


def plain_beside(search: Search, fit: Fit) -> Terms:
    """Return the plain friction and offsets that a fit does without; none where it has no friction anywhere."""
    if not any(c.effect.dissipative for c in fit.terms):
        return ()
    sites = search.start.rows.samples.columns.sites
    may = {e.id for e in search.effects}
    return tuple(
        c
        for c in search.with_background(fit).terms
        if c not in fit.terms
        and c.effect.id in may
        and c.site in sites.get(c.effect.id, (c.site,))
        and not _contained(c, fit.terms)
        and fit.share_left(fresh_columns(fit, c)) > LEAST_SHARE
    )


def fit_beside(prepared: Prepared, found: Sequence[Candidate], plain: Sequence[Candidate]) -> FittedModel:
    """Fit found terms and plain ones beside them, the latter only as far as the physics allows.

    Args:
        prepared: the data, with columns of all of them.
        found: terms of the search, at their final shapes.
        plain: those beside.

    Returns:
        A model whose terms are ``found`` and then those of ``plain`` that are possible; they may be zero.
    """
    plain, model = list(plain), fit_with_shapes(prepared, (*found, *plain))
    while driving := [c for c in plain if not allowed(model, c, INSIGNIFICANT)]:
        plain = [c for c in plain if c not in driving]
        model = fit_with_shapes(prepared, (*found, *plain))
    x = model.x
    while driving := [c for c in plain if not allowed(replace(model, x=x), c)]:
        plain = [c for c in plain if c not in driving]
        x = prepared.fit((*found, *plain)).x
    return _uneven(replace(model, x=x))


def _uneven(model: FittedModel) -> FittedModel:
    """Return the model with the variance of constants that uneven friction may be: (r c)^2, r RMS of offset over c."""
    columns = model.columns
    friction = columns.friction_of(model.proper_terms, model.x)
    own = {c.joint for c in model.proper_terms if c.effect.id in (OFFSET, UNEVEN) and c.site.always}
    others = [j for j in own if friction[j, 1] > 0]
    if not others:
        return model
    r2 = float((friction[others, 2] / friction[others, 1]).square().mean())
    covariance = model.covariance.clone()
    for c in model.proper_terms:
        if c.place is not None and c.place not in own and CONSTANT in c.labels and friction[c.place, 1] > 0:
            k = int((model.free == columns.index(c.place, CONSTANT)).nonzero())
            covariance[k, k] = model.covariance[k, k] + r2 * friction[c.place, 1] ** 2
    return replace(model, covariance=covariance)


def _contained(plain: Candidate, terms: Sequence[Candidate]) -> bool:
    """Say whether terms at the joint, in motion, are plain friction among others."""
    assert plain.effect.id in BACKGROUND
    parts = [p for c in terms if c.place == plain.place and c.site.always for p in PARTS.get(c.effect.id, ())]
    (own,) = torch.tensor(PARTS[plain.effect.id], dtype=torch.float64)
    if not parts:
        return False
    A = torch.tensor(parts, dtype=torch.float64).T
    return bool((own - A @ torch.linalg.lstsq(A, own.unsqueeze(1), driver="gelsd").solution[:, 0]).norm() < _SPANNED)
