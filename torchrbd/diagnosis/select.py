"""Choose the missing physics: grow a set of terms, prefer the simple, reconsider after every step.

Terms are taken if they predict unseen blocks better on several counts together: by enough, in enough blocks, and by a
part of the leftover that matters. Of several that do, the simplest that is not clearly worse is taken: the richer
term always fits better. Terms are offered singly and in pairs: two that act together may each look idle alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import torch
from torch import Tensor

from torchrbd.diagnosis.compare import Comparison, Gain
from torchrbd.inference.data.columns import Candidate
from torchrbd.inference.physical.prior import TERM_WIDTH

# 2 x 12.5 = 25 in units of 2 log L: over 800 candidates on recordings without any effect the largest seen was 18 (t
# 2.4).
LEAST_GAIN, LEAST_T, LEAST_PART = 12.5, 2.5, 0.01
# Not clearly worse: within two standard errors, 3 log-likelihood units or 0.3 % of the gain.
CLOSE_STD, CLOSE_GAIN, CLOSE_PART = 2.0, 3.0, 0.003
# A candidate of whose torque less than this is left beside the rigid body's is the rigid body's.
LEAST_SHARE = 1e-4
# Standard deviations within which a coefficient is what it is compared with.
INSIGNIFICANT = 3.0
# Additions a joint that are compared on left-out blocks in each round, best first by their gain on the blocks they
# were fitted to.
SHORTLIST = 8
MOST_TERMS_PER_JOINT = 6

Terms = tuple[Candidate, ...]


@dataclass(frozen=True)
class Scored:
    """A model, the joint at which it differs from the present one, and its left-out errors."""

    joint: int
    terms: Terms
    errors: Tensor


def distinguishable(comparison: Comparison, candidates: Sequence[Candidate]) -> list[Candidate]:
    """Return the candidates whose torque no inertial parameters can imitate."""
    return [c for c in candidates if comparison.share_left(c, ()) > LEAST_SHARE]


def select_terms(
    comparison: Comparison, candidates: Sequence[Candidate], report: Callable[[Terms], None] = lambda _: None
) -> Terms:
    """Return the terms that the blocks support, in the order found.

    Args:
        comparison: judges models.
        candidates: what may be chosen.
        report: told of the terms after each step.
    """
    terms: Terms = ()
    visited: set[frozenset[Candidate]] = {frozenset()}
    while True:
        comparison.set_noise(terms)
        for grown in _additions(comparison, terms, candidates):
            # The weights of the joints matter for fine choices, and what was missing has spoiled them until now.
            comparison.set_noise(grown)
            settled = _reconsidered(comparison, _without_idle(comparison, grown), candidates)
            if frozenset(settled) not in visited:
                break
        else:
            return terms
        terms = settled
        visited.add(frozenset(terms))
        report(terms)


def with_terms(terms: Terms, added: Terms) -> Terms:
    """Add candidates; each takes the place of terms at its joint whose features it contains."""
    for candidate in added:
        own = set(candidate.labels)
        terms = (*(c for c in terms if c.joint != candidate.joint or not set(c.labels) <= own), candidate)
    return terms


def accepted(comparison: Comparison, before: Tensor, after: Tensor, joint: int) -> bool:
    """Say whether errors ``after`` are better than ``before`` by gain, by t, and by a part of the joint's leftover."""
    found = comparison.gain(before, after)
    part = 1.0 - float(after[:, joint].sum() / before[:, joint].sum().clamp_min(1e-300))
    return found.total > LEAST_GAIN and found.t > LEAST_T and part > LEAST_PART


def clearly_worse(lead: Gain, best: float) -> bool:
    """Say whether a model is worse than the best one, whose gain is ``best``, beyond chance and triviality."""
    return lead.total > max(CLOSE_STD * lead.std, CLOSE_GAIN, CLOSE_PART * best)


def plausible(comparison: Comparison, terms: Terms) -> bool:
    """Say whether the physics allows the fitted parameters of all terms, and each differs from what the URDF says.

    Coefficients within chance of zero, or with a torque too small to matter, count as zero: that of a friction which
    the URDF has and the robot has not is as often negative as positive.
    """
    x, chance = comparison.fit(terms), INSIGNIFICANT * comparison.std(terms)
    moved = (x - comparison.prior.reference).abs() > chance
    trivial = LEAST_PART / TERM_WIDTH * comparison.prior.scale.diagonal()
    x = torch.where(x.abs() < torch.maximum(chance, trivial), torch.zeros_like(x), x)
    for c in terms:
        if not moved[comparison.columns.of(c)].any():
            return False
        values = c.effect.parameters(x[comparison.columns.of(c)], c.shape)
        if not c.effect.plausible({k: float(v) for k, v in values.items()}, comparison.columns.scale(c.site)):
            return False
    return True


def complexity(terms: Terms) -> int:
    """Return the number of coefficients and shape parameters of a set of terms."""
    return sum(c.effect.complexity for c in terms)


def simplest(comparison: Comparison, scored: Sequence[Scored], before: Tensor) -> list[Scored]:
    """Order models: the simplest at the best one's joint that is not clearly worse than the best, then the others.

    The others follow by their gain over ``before``.
    """
    by_gain = sorted(scored, key=lambda s: -comparison.gain(before, s.errors).total)
    if not by_gain:
        return []
    best = by_gain[0]
    top = comparison.gain(before, best.errors).total
    rivals = [
        s for s in by_gain if s.joint == best.joint and not clearly_worse(comparison.gain(s.errors, best.errors), top)
    ]
    first = min(rivals, key=lambda s: complexity(s.terms))
    return [first, *(s for s in by_gain if s is not first)]


def _additions(comparison: Comparison, terms: Terms, candidates: Sequence[Candidate]) -> Iterator[Terms]:
    """Yield grown sets of terms that are accepted, the one to prefer first."""
    before = comparison.errors(terms)
    scored = []
    for joint in sorted({c.joint for c in candidates}):
        for grown in _shortlist(comparison, terms, [c for c in candidates if c.joint == joint]):
            errors = comparison.errors(grown)
            if accepted(comparison, before, errors, joint) and plausible(comparison, grown):
                scored.append(Scored(joint, grown, errors))
    for choice in simplest(comparison, scored, before):
        yield choice.terms


def _shortlist(comparison: Comparison, terms: Terms, candidates: Sequence[Candidate]) -> list[Terms]:
    """Return the additions at one joint, singles and pairs of one-coefficient effects that fit the seen blocks best."""
    if sum(c.joint == candidates[0].joint for c in terms) >= MOST_TERMS_PER_JOINT:
        return []
    fresh = [c for c in candidates if c not in terms]
    pairs = combinations([c for c in fresh if c.effect.complexity == 1], 2)
    base = comparison.training_loss(terms)
    ranked = []
    for added in (*((c,) for c in fresh), *pairs):
        grown = with_terms(terms, added)
        gained = base - comparison.training_loss(grown)
        if gained > LEAST_GAIN:
            ranked.append((gained, grown))
    ranked.sort(key=lambda pair: CLOSE_GAIN * complexity(pair[1]) - pair[0])
    return [grown for _, grown in ranked[:SHORTLIST]]


def _without_idle(comparison: Comparison, terms: Terms) -> Terms:
    """Drop terms, one at a time, whose absence is not clearly worse."""
    while terms:
        full = comparison.errors(terms)
        idle = []
        for c in terms:
            rest = tuple(other for other in terms if other is not c)
            lead = comparison.gain(comparison.errors(rest), full)
            if not clearly_worse(lead, lead.total):
                idle.append((lead.total, rest))
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
        without = comparison.errors(rest)
        options = [Scored(old.joint, terms, comparison.errors(terms))]
        for candidate in candidates:
            if candidate.joint != old.joint or candidate in terms:
                continue
            changed = with_terms(rest, (candidate,))
            errors = comparison.errors(changed)
            if accepted(comparison, without, errors, old.joint) and plausible(comparison, changed):
                options.append(Scored(old.joint, changed, errors))
        terms = simplest(comparison, options, without)[0].terms
    return terms
