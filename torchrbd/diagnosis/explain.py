"""Turn chosen terms into findings: how sure, what else it could be, what it is worth, and a sentence for a person."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from torch import Tensor

from torchrbd.diagnosis.compare import Comparison, Gain
from torchrbd.diagnosis.results import Alternative, Finding, Quantity, Where
from torchrbd.diagnosis.select import CLOSE_GAIN, CLOSE_STD, Terms, plausible, with_terms
from torchrbd.diagnosis.words import finding_sentence
from torchrbd.inference.data.columns import Candidate
from torchrbd.inference.physical.fitting import FittedModel, judge
from torchrbd.inference.physical.terms import term_parameters
from torchrbd.inference.preparation import Prepared

# Below this share of its torque a term is nested in another one: nothing of it is left beside the other.
NESTED_SHARE = 1e-6
LARGEST_PROBABILITY = 0.999


@dataclass(frozen=True)
class Rival:
    """Another effect in the place of a finding, and what the finding gains over it on left-out blocks."""

    candidate: Candidate
    lead: Gain


def explain(
    prepared: Prepared,
    comparison: Comparison,
    terms: Terms,
    candidates: Sequence[Candidate],
    model: FittedModel,
) -> tuple[Finding, ...]:
    """Describe each chosen term.

    Args:
        prepared: the data.
        comparison: judged the terms.
        terms: those chosen.
        candidates: those that could have been.
        model: the fit with all terms.

    Returns:
        Findings, the largest gain first.
    """
    comparison.set_noise(terms)
    full = comparison.errors(terms)
    judging = prepared.judging
    after = judge(judging, model.x).nmse
    found = []
    for term in terms:
        rest = tuple(c for c in terms if c is not term)
        worth = comparison.gain(comparison.errors(rest), full)
        rivals = _rivals(comparison, term, rest, candidates, full)
        before = judge(judging, prepared.fit(rest, model.noise_variance).x).nmse
        found.append(_finding(term, model, worth, rivals, before, after))
    return tuple(sorted(found, key=lambda f: -f.log_evidence_gain))


def _rivals(
    comparison: Comparison, term: Candidate, rest: Terms, candidates: Sequence[Candidate], full: Tensor
) -> list[Rival]:
    """Return the best shape of every other effect at the joint in the term's place.

    Effects that contain the term fit as well by construction and are no rivals.
    """
    best: dict[str, Rival] = {}
    for candidate in candidates:
        if candidate.joint != term.joint or candidate.effect.id == term.effect.id:
            continue
        changed = with_terms(rest, (candidate,))
        if set(term.labels) <= set(candidate.labels):
            continue
        if comparison.share_left(term, changed) < NESTED_SHARE or not plausible(comparison, changed):
            continue
        lead = comparison.gain(comparison.errors(changed), full)
        known = best.get(candidate.effect.id)
        if known is None or lead.total < known.lead.total:
            best[candidate.effect.id] = Rival(candidate, lead)
    return list(best.values())


def indistinguishable(lead: Gain) -> bool:
    """Say whether the lead over a rival is within chance."""
    return lead.total < max(CLOSE_STD * lead.std, CLOSE_GAIN)


def probability(worth: Gain, rivals: Sequence[Rival]) -> float:
    """Return the probability of a term against none and against each rival, from its left-out leads G over them.

        p = 1 / (1 + sum_r o_r),   o = max(exp(-G), exp(-t^2 / 2)),   t = G / std(G)

    The odds are the likelihood ratio, but never longer than the scatter of the lead over the blocks supports:
    correlated noise and other physics left out make the likelihood overconfident.
    """
    odds = 0.0
    for lead in (worth, *(r.lead for r in rivals)):
        odds += max(math.exp(-max(lead.total, 0.0)), math.exp(-0.5 * max(lead.t, 0.0) ** 2))
    return min(1.0 / (1.0 + odds), LARGEST_PROBABILITY)


def _finding(
    term: Candidate,
    model: FittedModel,
    worth: Gain,
    rivals: Sequence[Rival],
    before: Mapping[str, float],
    after: Mapping[str, float],
) -> Finding:
    columns, robot = model.columns, model.columns.robot
    joint, prismatic = robot.joint_names[term.joint], bool(robot.prismatic[term.joint])
    quantities = {
        name: Quantity(value, std, term.effect.unit(name, prismatic=prismatic), columns.urdf_value(term))
        for name, (value, std) in term_parameters(model, term).items()
    }
    alike = tuple(Alternative(r.candidate.effect.id, (joint,)) for r in rivals if indistinguishable(r.lead))
    return Finding(
        effect=term.effect.id,
        joints=(joint,),
        links=(),
        probability=probability(worth, rivals),
        log_evidence_gain=worth.total,
        parameters=quantities,
        where=Where(),
        indistinguishable_from=alike,
        nmse_before={name: value for name, value in before.items() if name == joint},
        nmse_after={name: value for name, value in after.items() if name == joint},
        statement=finding_sentence(term.effect.id, joint, quantities, before, after, alike),
    )
