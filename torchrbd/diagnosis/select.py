"""Choose the missing physics: grow a set of terms, prefer the simple, reconsider after every step.

A term is taken if it predicts unseen blocks better on several counts together: by enough, in enough blocks, and by a part of the
leftover that matters. Of several that do, the simplest that is not clearly worse is taken: the richer term always fits
better.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from torchrbd.diagnosis.compare import Comparison, Gain, gain
from torchrbd.inference.columns import Candidate

# 2 x 12.5 = 25 in units of 2 log L: over 800 candidates on recordings without any effect the largest seen was 18 (t 2.4).
LEAST_GAIN, LEAST_T, LEAST_PART = 12.5, 2.5, 0.01
# Not clearly worse: within two standard errors, 3 log-likelihood units or 0.3 % of the gain.
CLOSE_STD, CLOSE_GAIN, CLOSE_PART = 2.0, 3.0, 0.003
# A candidate of whose torque less than this is left beside the rigid body's is the rigid body's.
LEAST_SHARE = 1e-4
# Candidates compared on left-out blocks in each round, best first by their gain on the blocks they were fitted to.
SHORTLIST = 24
MOST_TERMS_PER_JOINT = 6

Terms = tuple[Candidate, ...]


@dataclass(frozen=True)
class Scored:
    """A candidate model and its left-out losses."""

    candidate: Candidate
    terms: Terms
    losses: Tensor


def select_terms(comparison: Comparison, candidates: Sequence[Candidate], report: Callable[[str], None] = lambda _: None) -> Terms:
    """Return the terms that the blocks support, in the order found.

    Args:
        comparison: judges models.
        candidates: what may be chosen.
        report: told of each term as it is found.
    """
    terms: Terms = ()
    visited = {frozenset(terms)}
    while True:
        comparison.set_noise(terms)
        step = _addition(comparison, terms, candidates)
        if step is None:
            break
        terms = _without_idle(comparison, step)
        terms = _reconsidered(comparison, terms, candidates)
        if frozenset(terms) in visited:
            break
        visited.add(frozenset(terms))
        report(", ".join(f"{c.effect.id} at {comparison.columns.robot.joint_names[c.joint]}" for c in terms))
    return terms


def with_term(terms: Terms, candidate: Candidate) -> Terms:
    """Add a candidate; it takes the place of terms at its joint whose features it contains."""
    own = set(candidate.labels)
    return (*(c for c in terms if c.joint != candidate.joint or not set(c.labels) <= own), candidate)


def accepted(comparison: Comparison, before: Tensor, after: Tensor, joint: int) -> bool:
    """Say whether losses ``after`` are better than ``before`` on all counts: gain, t, and part of the joint's leftover."""
    found = gain(before, after)
    part = 1.0 - float(after[:, joint].sum() / before[:, joint].sum().clamp_min(1e-300))
    return found.total > LEAST_GAIN and found.t > LEAST_T and part > LEAST_PART


def clearly_worse(difference: Gain, best: float) -> bool:
    """Say whether a model that loses ``difference`` to the best one (whose gain is ``best``) is beyond chance and triviality."""
    return difference.total > max(CLOSE_STD * difference.std, CLOSE_GAIN, CLOSE_PART * best)


def plausible(comparison: Comparison, terms: Terms) -> bool:
    """Say whether the fitted parameters of all terms are ones that their physics allows; the URDF's own friction counts in."""
    x = comparison.fit(terms)
    for c in terms:
        values = c.effect.parameters(x[comparison.columns.of(c)], c.shape)
        if not c.effect.plausible({k: float(v) for k, v in values.items()}, comparison.columns.scales[c.joint]):
            return False
    return True


def simplest(scored: Sequence[Scored], before: Tensor) -> Scored:
    """Return the simplest of the models at the best one's joint that is not clearly worse than the best."""
    best = min(scored, key=lambda s: float(s.losses.sum()))
    top = gain(before, best.losses).total
    rivals = [
        s
        for s in scored
        if s.candidate.joint == best.candidate.joint and not clearly_worse(gain(s.losses, best.losses), top)
    ]
    return min(rivals, key=lambda s: (complexity(s.terms), float(s.losses.sum())))


def complexity(terms: Terms) -> int:
    """Return the number of coefficients and shape parameters of a set of terms."""
    return sum(c.effect.complexity for c in terms)


def _addition(comparison: Comparison, terms: Terms, candidates: Sequence[Candidate]) -> Terms | None:
    before = comparison.losses(terms)
    scored = []
    for candidate in _shortlist(comparison, terms, candidates):
        enlarged = with_term(terms, candidate)
        losses = comparison.losses(enlarged)
        if accepted(comparison, before, losses, candidate.joint) and plausible(comparison, enlarged):
            scored.append(Scored(candidate, enlarged, losses))
    return simplest(scored, before).terms if scored else None


def _shortlist(comparison: Comparison, terms: Terms, candidates: Sequence[Candidate]) -> list[Candidate]:
    """Return the candidates that fit the seen blocks best and that the model cannot imitate."""
    present = {(c.joint, c.effect.id, tuple(c.shape.items())) for c in terms}
    base = comparison.training_loss(terms)
    ranked = []
    for candidate in candidates:
        if (candidate.joint, candidate.effect.id, tuple(candidate.shape.items())) in present:
            continue
        if sum(c.joint == candidate.joint for c in terms) >= MOST_TERMS_PER_JOINT:
            continue
        gained = base - comparison.training_loss(with_term(terms, candidate))
        if gained > LEAST_GAIN:
            ranked.append((gained, candidate))
    ranked.sort(key=lambda pair: -pair[0])
    chosen = [candidate for _, candidate in ranked[:SHORTLIST]]
    return [c for c in chosen if comparison.share_left(c, terms) > LEAST_SHARE]


def _without_idle(comparison: Comparison, terms: Terms) -> Terms:
    """Drop terms, one at a time, whose absence is not clearly worse."""
    while terms:
        full = comparison.losses(terms)
        idle = []
        for c in terms:
            rest = tuple(other for other in terms if other is not c)
            losses = comparison.losses(rest)
            if not accepted(comparison, losses, full, c.joint):
                idle.append((float(losses.sum()), rest))
        if not idle:
            return terms
        terms = min(idle, key=lambda pair: pair[0])[1]
    return terms


def _reconsidered(comparison: Comparison, terms: Terms, candidates: Sequence[Candidate]) -> Terms:
    """Re-choose each term given the others: simpler if that is not clearly worse, other if that is clearly better."""
    for old in tuple(terms):
        if old not in terms:
            continue
        rest = tuple(c for c in terms if c is not old)
        without = comparison.losses(rest)
        options = [Scored(old, terms, comparison.losses(terms))]
        for candidate in candidates:
            if candidate.joint != old.joint or candidate == old:
                continue
            changed = with_term(rest, candidate)
            losses = comparison.losses(changed)
            if accepted(comparison, without, losses, old.joint) and plausible(comparison, changed):
                options.append(Scored(candidate, changed, losses))
        terms = simplest(options, without).terms
    return terms
