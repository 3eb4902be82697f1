"""The model with what was found: physically valid, in the band of the fit, as identification fits it.

Curves over a joint's own velocity, acceleration or load, which friction and inertia are linear in, are fitted to what
all else leaves, so that none stands in for a part of these:

    (C'C / s^2 + D^-2) w = C'(tau - X x) / s^2,   w ~ N(0, D^2)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch

from torchrbd.diagnosis.friction import Friction, ordinary_friction
from torchrbd.diagnosis.residual import stands_in
from torchrbd.diagnosis.search import Explanation
from torchrbd.inference.physical.fitting import FittedModel
from torchrbd.inference.preparation import Prepared
from torchrbd.inference.shapes.refine import fit_with_shapes, refined_from
from torchrbd.inference.shapes.reread import reread
from torchrbd.likelihood.block_statistics import assemble
from torchrbd.likelihood.columns import Candidate
from torchrbd.likelihood.reading import Progress


@dataclass(frozen=True)
class Extended:
    """A model with ordinary friction and all that was found.

    Attributes:
        prepared: the data, with columns of all terms.
        laws: the fit of all but the curves that could stand in for a part of it.
        model: the same with these, fitted to what it leaves.
        friction: ordinary friction, in the order of the model's first terms.
        terms: what was found, in the order of the explanation, their shapes final.
    """

    prepared: Prepared
    laws: FittedModel
    model: FittedModel
    friction: tuple[Friction, ...]
    terms: tuple[Candidate, ...]


def extended(prepared: Prepared, found: Explanation, may: Sequence[str], progress: Progress) -> Extended:
    """Fit ordinary friction and what was found to all that is not held out.

    Args:
        prepared: the data.
        found: what was found.
        may: ids of the effects that may be there.
        progress: told how far the work is.
    """
    columns = prepared.columns
    own = [t.own.candidate for t in found.terms]
    shifted = {c.joint for c in own if c.effect.id == "torque_offset" and c.site.always}
    friction = ordinary_friction(found.fit, columns, may, shifted)
    # Nothing is larger than the likelihood believes.
    believed = {
        (t.own.candidate.effect.id, t.own.candidate.site): t.own.extra(found.fit, found.rows).std for t in found.terms
    }
    prepared = replace(prepared, believed=believed)
    named = (
        *(f.candidate for f in friction),
        *(columns.candidate(c.effect, c.site, c.shape) for c in own if not stands_in(c)),
    )
    wider = columns.of_candidates(named, found.fit.pi, found.fit.hyper.friction)
    prepared, named = refined_from(reread(prepared, wider, progress), named, progress)
    curves = tuple(columns.candidate(c.effect, c.site, c.shape) for c in own if stands_in(c))
    if curves:
        columns = prepared.columns
        every = columns.of_candidates((*columns.candidates, *curves), columns.pi, columns.friction)
        prepared = reread(prepared, every, progress)
    laws = fit_with_shapes(prepared, named)
    rest = {True: iter(curves), False: iter(named[len(friction) :])}
    return Extended(
        prepared, laws, with_curves(prepared, laws, curves), friction, tuple(next(rest[stands_in(c)]) for c in own)
    )


def with_curves(prepared: Prepared, laws: FittedModel, curves: Sequence[Candidate]) -> FittedModel:
    """Return a model with curves fitted to what it leaves."""
    if not curves:
        return laws
    columns = prepared.columns
    at = torch.tensor([k for c in curves for k in columns.of(c)])
    H, h = assemble(columns, prepared.training.total(), 1.0 / laws.noise_variance)
    precision = H[at.unsqueeze(1), at] + torch.diag(prepared.prior.scale[at, at] ** -2.0)
    covariance, x = torch.linalg.inv(precision), laws.x.clone()
    x[at] = covariance @ (h - H @ laws.x)[at]
    return replace(
        laws,
        terms=(*laws.terms, *curves),
        x=x,
        free=torch.cat((laws.free, at)),
        laplace=torch.block_diag(laws.laplace, covariance),
        covariance=torch.block_diag(laws.covariance, covariance),
        scatter=None,
    )
