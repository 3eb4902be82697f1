"""The extended model: physically valid, its coefficients fitted by least squares in the band of identification.

Terms, their shapes (such as the frequency of a ripple), load and friction in features, and prior sizes are those of the
search. The coefficients of the search come from whitened rows of a wide band. They decide what is there, but where a
law is not quite right they predict worse than these.

Friction and inertia are linear in a joint's own velocity, acceleration and load, and Coulomb friction is one of the
friction curves over any signal. Such curves could absorb a part of friction and inertia. They are therefore fitted to
the residual of all else, and friction is reported without them:

    w ~ N(0, D^2),   (C'C / s^2 + D^-2) w = C'(tau - X x) / s^2

with the features C and coefficients w of the curves, their prior D, all other columns X x, and the noise s.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from torchrbd.dataset.columns import Candidate
from torchrbd.dataset.reading import Progress
from torchrbd.dataset.shapes import slopes
from torchrbd.diagnosis.curve_hypotheses import has_friction
from torchrbd.diagnosis.friction import OFFSET, Friction, ordinary_friction, weighed_given
from torchrbd.diagnosis.outcome import SearchOutcome, Term
from torchrbd.diagnosis.results import Elpd
from torchrbd.diagnosis.sharpening import shape_stds
from torchrbd.effects import Site
from torchrbd.effects.base import LEVEL
from torchrbd.inference.physical.fitting import FittedModel
from torchrbd.inference.preparation import Prepared
from torchrbd.inference.shapes.refine import fit_with_shapes
from torchrbd.inference.shapes.reread import reread, with_input_noise
from torchrbd.likelihood.equations import scaled_equations
from torchrbd.likelihood.extra import Extra
from torchrbd.likelihood.likelihood import Likelihood


@dataclass(frozen=True)
class FinalModel:
    """A model with baseline friction and all that was found.

    Attributes:
        prepared: the data, with columns of all terms.
        found: by the search.
        first: the fit without the curves that could absorb a part of it.
        model: the same with these curves, fitted to its residual.
        friction: baseline friction, in the order of the model's first terms.
        terms: what was found, in the order of the explanation.
        open: of each term, the covariance (K, K) of its coefficients in the likelihood. It includes what this fit
            takes as known: whether friction differs by direction, the level of a drift, the clocks.
        may: ids of the effects that may be there.
    """

    prepared: Prepared
    found: SearchOutcome
    first: FittedModel
    model: FittedModel
    friction: tuple[Friction, ...]
    terms: tuple[Candidate, ...]
    open: tuple[np.ndarray, ...]
    may: tuple[str, ...]

    def without(self, gone: Mapping[Candidate, Elpd]) -> FinalModel:
        """Return the fit without some of its ``terms``, all else at the shapes, and in the noise, that it has.

        A law leaves one that is nested in it, as a spring an offset, if that is likelier than not. What is gone may
        have absorbed baseline friction, which is weighed again.

        Args:
            gone: these terms, and what left-out blocks say of each.
        """
        fit, columns, each = self.found.fit, self.model.columns, list[tuple[Term, Candidate, Extra]]()
        for term, c, extra in zip(self.found.terms, self.terms, fit.extra, strict=True):
            if c not in gone:
                each.append((term, c, extra))
            elif (nested := term.nested_law(self.found.rows, gone[c])) is not None:
                own = nested.own.candidate
                each.append(
                    (nested, columns.candidate(own.effect, own.site, own.shape), nested.own.extra(fit, self.found.rows))
                )
        terms, fit = tuple(c for _, c, _ in each), fit.extended([extra for _, _, extra in each])
        found = replace(self.found, fit=fit, terms=tuple(term for term, _, _ in each))
        before = dict(zip(self.terms, self.open, strict=True))
        left_open = tuple(before[c] if c in before else fit.coefficients_covariance(k) for k, c in enumerate(terms))
        given, laws = _friction_given(found)
        friction = (*self.friction, *(Friction(c, -math.inf, 0.0) for c in self.offsets_without(gone, terms)))
        friction = tuple(weighed_given(f, given, columns.robot, laws) for f in friction)
        others = (*(f.candidate for f in friction), *(c for c in terms if not has_friction(c)))
        curves = tuple(c for c in terms if has_friction(c))
        first = fit_with_shapes(self.prepared, others)
        model = with_curves(self.prepared, first, curves) if curves else first
        return replace(self, found=found, first=first, model=model, friction=friction, terms=terms, open=left_open)

    def offsets_without(self, gone: Collection[Candidate], kept: Collection[Candidate]) -> list[Candidate]:
        """Return the offsets that joints have where a law with a level is gone, and no other has the level."""
        levels = {c.place for c in kept if LEVEL in c.labels}
        joints = {c.joint for c in gone if LEVEL in c.labels and c.place not in levels}
        at = sorted(joints) if OFFSET.id in self.may else []
        return [self.model.columns.candidate(OFFSET, Site(j), {}) for j in at]


def fit_final_model(prepared: Prepared, found: SearchOutcome, may: Sequence[str], progress: Progress) -> FinalModel:
    """Fit baseline friction and what was found to all data that is not held out.

    Args:
        prepared: the data.
        found: what was found.
        may: ids of the effects that may be there.
        progress: called with how far the work is.
    """
    columns = prepared.columns
    own = [t.own.candidate for t in found.terms]
    given, laws = _friction_given(found)
    friction = ordinary_friction(given, columns, may, laws)
    # Nothing is larger than the likelihood believes; of two kinds at one place, than of the larger.
    prior_stds: dict[tuple[str, Site], np.ndarray] = {}
    for t in found.terms:
        at, std = (t.own.candidate.effect.id, t.own.candidate.site), t.own.extra(found.fit, found.rows).std
        prior_stds[at] = np.maximum(std, prior_stds.get(at, 0.0))
    # The level of the drift, which these offsets are, has its size.
    offsets = [f.candidate.site for f in friction if f.candidate.effect is OFFSET]
    prior_stds |= {(OFFSET.id, at): given.hyper.drift[np.array([at.joint])] for at in offsets}
    prepared = replace(prepared, prior_stds=prior_stds, known_shapes=shape_stds(found.fit, found.rows, own))
    terms = tuple(columns.candidate(c.effect, c.site, c.shape) for c in own)
    weights = [torch.from_numpy(found.fit.coefficients(k)) for k in range(len(terms))]
    others = (*(f.candidate for f in friction), *(c for c in terms if not has_friction(c)))
    curves = tuple(c for c in terms if has_friction(c))
    around = [s for c, w in zip(terms, weights, strict=True) if c not in curves for s in slopes(columns, c, w)]
    supplied = found.fit.around_its_fit(alone=True)
    every = columns.of_candidates((*others, *curves, *around), supplied.pi, supplied.friction)
    prepared = with_input_noise(reread(prepared, every, progress), others)
    first = fit_with_shapes(prepared, others)
    left_open = tuple(found.fit.coefficients_covariance(k) for k in range(len(terms)))
    model = with_curves(prepared, first, curves) if curves else first
    return FinalModel(prepared, found, first, model, friction, terms, left_open, tuple(may))


def _friction_given(found: SearchOutcome) -> tuple[Likelihood, list[Candidate]]:
    """Return the likelihood in which friction is weighed, and its laws: without curves that could be a proxy for it."""
    own = [t.own.candidate for t in found.terms]
    others = [e for e, c in zip(found.fit.extra, own, strict=True) if not has_friction(c)]
    fit = found.fit if len(others) == len(own) else found.fit.extended(others).refit
    return fit.with_heavy_tails(), [c for c in own if not has_friction(c)]


def with_curves(prepared: Prepared, first: FittedModel, curves: Sequence[Candidate]) -> FittedModel:
    """Return a model with curves fitted to what it leaves, its own coefficients as they are."""
    columns, prior = prepared.columns, replace(prepared.prior, mean=first.x)
    at = torch.tensor([k for c in curves for k in columns.of(c)])
    found = scaled_equations(prior, prepared.training.total(), columns, 1.0 / first.noise_variance).posterior(at)
    size = prior.scale.diagonal()[at]
    covariance = size.unsqueeze(1) * torch.from_numpy(found.covariance(range(len(at)))) * size
    return replace(
        first,
        terms=(*first.terms, *curves),
        x=first.x.index_add(0, at, size * torch.from_numpy(found.z)),
        free=torch.cat((first.free, at)),
        laplace=torch.block_diag(first.laplace, covariance),
        covariance=torch.block_diag(first.covariance, covariance),
        prior_covariance=torch.block_diag(first.prior_covariance, size.square().diag()),
        scatter=None if first.scatter is None else first.scatter.with_coefficients(at, covariance),
    )
