"""Laws no richer than their estimates: a spring whose stiffness may be zero is a constant torque.

A law that has all columns of a rival at the same place, and some more, is the rival where the coefficients of these are
zero. It is likelier than the rival by no more than what their estimates say, see ``evidence_of_estimate``:

    log B(law) <= log B(rival) + log B(the other coefficients, given the law)

Where the rival is then the likelier of the two, it takes the law's place in the model.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from torchrbd.dataset.columns import Candidate
from torchrbd.dataset.reading import Progress
from torchrbd.diagnosis.evidence_cap import evidence_of_estimate
from torchrbd.diagnosis.final_model import FinalModel, fit_final_model
from torchrbd.diagnosis.hypotheses import Hypothesis, prior_std
from torchrbd.diagnosis.outcome import Term
from torchrbd.inference.preparation import Prepared


def simplified(model: FinalModel, prepared: Prepared, may: Sequence[str], progress: Progress) -> FinalModel:
    """Return a model in which no law is richer than its estimate.

    Args:
        model: the extended model.
        prepared: the data that it was made from.
        may: ids of effects that may be there.
        progress: called with the stage of the work and how far it is.
    """
    found = model.found
    terms = tuple(_with_simpler_law(model, *one) for one in zip(found.terms, model.terms, model.open, strict=True))
    if any(new.own.name != old.own.name for new, old in zip(terms, found.terms, strict=True)):
        extra = [
            old if new.own.name == term.own.name else new.own.extra(found.fit, found.rows)
            for new, term, old in zip(terms, found.terms, found.fit.extra, strict=True)
        ]
        fit = found.fit.extended(extra).refit
        again = fit_final_model(prepared, replace(found, fit=fit, terms=terms), may, progress)
        return simplified(again, prepared, may, progress)
    return replace(model, found=replace(found, terms=terms))


def as_estimated(model: FinalModel, term: Term, candidate: Candidate, covariance: np.ndarray) -> Term:
    """Return a term, and its rivals, no surer than the estimate of the term.

    Args:
        model: the fit that has the estimate.
        term: of its search.
        candidate: the same term in the fit, its shape final.
        covariance: (K, K) of its coefficients in the likelihood of the search.
    """
    std = _prior_std(model, term.own)
    less = min(0.0, evidence_of_estimate(model.model, candidate, std, covariance) - term.own.log_evidence)
    own, *rivals = (replace(h, log_evidence=h.log_evidence + less) for h in (term.own, *term.rivals))
    return Term(own, tuple(rivals))


def _with_simpler_law(model: FinalModel, term: Term, candidate: Candidate, covariance: np.ndarray) -> Term:
    """Return a term with the evidence that its estimate leaves it against simpler laws, and the likeliest law first."""
    own, std = term.own, _prior_std(model, term.own)
    for simpler in (h for h in term.rivals if _is_part(h.candidate, candidate)):
        more = set(candidate.labels).difference(simpler.candidate.labels)
        most = simpler.log_evidence + evidence_of_estimate(model.model, candidate, std, covariance, labels=more)
        own = replace(own, log_evidence=min(own.log_evidence, most))
    best = Term(own, term.rivals).best(model.found.rows)
    if best is own or not _is_part(best.candidate, candidate):
        return Term(own, term.rivals)
    return Term(best, (own, *(h for h in term.rivals if h is not best)))


def _prior_std(model: FinalModel, own: Hypothesis) -> np.ndarray:
    return prior_std(model.found.fit, model.found.rows, own.candidate)[0] * own.scale


def _is_part(one: Candidate, other: Candidate) -> bool:
    """Say whether a law at the same place has some of another one's columns and no others."""
    return one.site == other.site and set(one.labels) < set(other.labels)
