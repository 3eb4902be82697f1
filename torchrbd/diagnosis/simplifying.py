"""Laws no richer than their estimates: a spring whose stiffness may be zero is a constant torque.

A law may have all columns of a rival at the same place, and some more. Where the coefficients of these are zero, it is
the rival. It is likelier than the rival by no more than their estimates allow, see ``estimate_evidence``:

    log B(law) <= log B(rival) + log B(the other coefficients, given the law)

If the rival is then the likelier of the two, it replaces the law in the model.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from torchrbd.diagnosis.estimate_evidence import estimate_evidence
from torchrbd.diagnosis.extending import Extended, extended
from torchrbd.diagnosis.hypotheses import Hypothesis, believed
from torchrbd.diagnosis.terms import Term
from torchrbd.inference.preparation import Prepared
from torchrbd.likelihood.columns import Candidate
from torchrbd.likelihood.reading import Progress


def simplified(model: Extended, prepared: Prepared, may: Sequence[str], progress: Progress) -> Extended:
    """Return a model in which no law is richer than its estimate.

    Args:
        model: the extended model.
        prepared: the data that it was made from.
        may: ids of effects that may be there.
        progress: called with the stage and the part of it that is done.
    """
    found = model.found
    every = zip(found.terms, model.terms, model.open, strict=True)
    terms = tuple(_as_estimated(model, *one) for one in every)
    same = all(new.own.name == old.own.name for new, old in zip(terms, found.terms, strict=True))
    if same:
        return replace(model, found=replace(found, terms=terms))
    extra = [
        old if new.own.name == term.own.name else new.own.extra(found.fit, found.rows)
        for new, term, old in zip(terms, found.terms, found.fit.extra, strict=True)
    ]
    fit = found.fit.extended(extra).refit
    return simplified(extended(prepared, replace(found, fit=fit, terms=terms), may, progress), prepared, may, progress)


def _as_estimated(model: Extended, term: Term, candidate: Candidate, covariance: np.ndarray) -> Term:
    """Return a term with the evidence that its estimate leaves it against simpler laws, and the likeliest law first."""
    own, found = term.own, model.found
    std = believed(found.fit, found.rows, own.candidate)[0] * own.scale
    for simpler in (h for h in term.rivals if _is_part(h.candidate, candidate)):
        more = set(candidate.labels).difference(simpler.candidate.labels)
        most = simpler.log_evidence + estimate_evidence(model.model, candidate, std, covariance, labels=more)
        own = replace(own, log_evidence=min(own.log_evidence, most))
    best = Term(own, term.rivals).best(found.rows)
    if best is own or not _is_part(best.candidate, candidate):
        return Term(own, term.rivals)
    return Term(best, (own, *_others(term.rivals, best)))


def _others(rivals: Sequence[Hypothesis], one: Hypothesis) -> tuple[Hypothesis, ...]:
    return tuple(h for h in rivals if h is not one)


def _is_part(one: Candidate, other: Candidate) -> bool:
    """Say whether a law at the same place has some of another one's columns and no others."""
    return one.site == other.site and set(one.labels) < set(other.labels)
