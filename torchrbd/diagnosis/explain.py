"""Turn what was found into findings: how sure, what else it could be, and what it is worth on held-out data."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import torch

from torchrbd.dataset.columns import Candidate, Columns
from torchrbd.diagnosis.curve_hypotheses import is_curve
from torchrbd.diagnosis.curves import driven_by, fitted_curve
from torchrbd.diagnosis.decisions import DECISIONS
from torchrbd.diagnosis.final_model import FinalModel
from torchrbd.diagnosis.friction import COULOMB, OFFSET, UNEVEN, Friction
from torchrbd.diagnosis.hypotheses import Hypothesis, whole
from torchrbd.diagnosis.outcome import SearchOutcome
from torchrbd.diagnosis.posterior import (
    Inclusion,
    excess_evidence,
    inclusion,
    limit_evidence,
    log_odds,
    probability_of,
)
from torchrbd.diagnosis.proof import Proof, backward_elimination
from torchrbd.diagnosis.ranked import Ranked, Ranking
from torchrbd.diagnosis.ranking import SearchResult
from torchrbd.diagnosis.refitted_models import RefittedModels
from torchrbd.diagnosis.results import (
    Alternative,
    Elpd,
    Finding,
    Law,
    NextEffect,
    Quantity,
    Region,
    Where,
    strongest_first,
)
from torchrbd.diagnosis.variant import another_variant
from torchrbd.effects import Effect
from torchrbd.effects.base import UNEVENNESS
from torchrbd.effects.smooth_torque import HUM
from torchrbd.inference.physical.fitting import FittedModel
from torchrbd.inference.physical.terms import coulomb_in_motion, estimated_parameters
from torchrbd.robot import RobotModel

# Standard deviations of intervals of 95 %, and of a bound.
_TWO_SIDED, _ONE_SIDED = 1.96, 1.645


@dataclass(frozen=True)
class Explained:
    """The report on the terms that were found.

    Attributes:
        findings: those that left-out blocks confirm, the strongest first.
        not_confirmed: others that the search found.
        model: without terms that are not confirmed; baseline friction may have absorbed parts of these.
        curves: what its smooth curves are worth.
    """

    findings: tuple[Finding, ...]
    not_confirmed: tuple[Finding, ...]
    model: FinalModel
    curves: dict[Candidate, Elpd]


def explain(extended: FinalModel) -> Explained:
    """Describe what was found, and what left-out blocks confirm of it; the model is left with what it needs."""
    proof = Proof(extended)
    judged = [term for term in extended.terms if term.effect is not HUM]
    gone = backward_elimination(proof, judged, partial(_is_needed, extended))
    dropped = [_judged(term, one, proof.fits) for term, one in _described(extended, gone) if term in gone]
    if gone:
        extended = extended.without(gone)
        proof = Proof(extended)
    curves = {term: proof.elpd(term) for term in extended.terms if is_curve(term) and term.effect is not HUM}
    worth = {term: proof.elpd(term) for term, _, _ in _sure(extended, {})}
    every = [(term, _judged(term, one, proof.fits)) for term, one in _described(extended, worth)]
    findings = [one for _, one in _once([pair for pair in every if pair[1].confirmed], extended.model.columns)]
    not_confirmed = [*(one for _, one in every if not one.confirmed), *dropped]
    return Explained(_completed(findings, extended), _completed(not_confirmed, extended), extended, curves)


def _is_needed(extended: FinalModel, term: Candidate, elpd: Elpd) -> bool:
    """Say whether a term is likelier than not and matters; a curve has no name, and need only predict better."""
    if is_curve(term):
        return elpd.certain
    found = extended.found
    one = found.terms[extended.terms.index(term)]
    return elpd.matters and log_odds(limit_evidence(one.own, one.rivals, elpd)[0], found.rows) > 0.0


def _judged(term: Candidate, one: Finding, fits: RefittedModels) -> Finding:
    """Return a finding with its errors on held-out data, or in its own window where held-out data has none of it."""
    if not fits.held_out_sees(term):
        return fits.in_its_time(term, one)
    return replace(fits.judged(term, one), held_out_ratio=fits.held_out_ratio(term, one))


def _completed(found: Sequence[Finding], extended: FinalModel) -> tuple[Finding, ...]:
    """Return findings, the strongest first, with what else is to be said of them."""
    robot = extended.prepared.robot
    always = {(c.effect.id, *places(robot, c)) for c, _, _ in _sure(extended, {}) if c.site.recordings is None}
    more = [one.where.recordings is not None and (one.effect, one.joints, one.links) in always for one in found]
    return strongest_first(
        replace(
            one,
            adds_to_all=adds,
            variant=another_variant(one, robot),
            coulomb_in_motion=_coulomb_in_motion(one, extended.model),
        )
        for one, adds in zip(found, more, strict=True)
    )


def _coulomb_in_motion(one: Finding, model: FittedModel) -> Quantity | None:
    """Return the Coulomb friction of a joint if the finding is one of several laws that each have a part of it."""
    names = model.columns.robot.joint_names
    dry = [c for c in model.proper_terms if c.effect.dry and c.site.always and names[c.joint] in one.joints]
    own = [set(model.columns.of(c)) for c in dry]
    laws = [c for c, mine in zip(dry, own, strict=True) if not any(mine < others for others in own)]
    if len(laws) < 2 or one.effect not in [c.effect.id for c in dry] or one.where != Where():
        return None
    value, std = coulomb_in_motion(model, laws)
    joint = laws[0].joint
    return Quantity(value, std, COULOMB.unit("coulomb", prismatic=bool(model.columns.robot.prismatic[joint])))


def _once(kept: Sequence[tuple[Candidate, Finding]], columns: Columns) -> list[tuple[Candidate, Finding]]:
    """Return findings without those that another one, as sure, contains: its parameters have their torque."""
    every = [(one, set(columns.of(term))) for term, one in kept]

    def is_part(one: Finding, own: set[int]) -> bool:
        return any(own < its and one.probability <= other.probability for other, its in every)

    return [pair for pair, (one, own) in zip(kept, every, strict=True) if not is_part(one, own)]


def _described(extended: FinalModel, worth: Mapping[Candidate, Elpd]) -> list[tuple[Candidate, Finding]]:
    """Return the terms of a model that may be findings, described; ``worth`` says what left-out blocks say of them."""
    reading = extended.prepared.reading
    ends_s = {r.name: s.segments[-1][1] for r, s in zip(reading.recordings, reading.surveys, strict=True)}
    found = list[tuple[Candidate, Finding]]()
    for term, evidence, sure in _sure(extended, worth):
        one = _finding(term, evidence, sure, extended, ends_s, _alternatives(term, sure, extended))
        found.append((term, replace(one, elpd=worth.get(term))))
    return found


def _sure(extended: FinalModel, worth: Mapping[Candidate, Elpd]) -> Iterator[tuple[Candidate, float, Inclusion]]:
    """Yield the terms of a model that may be findings, their log evidence, and how sure they are."""
    found, terms = extended.found, extended.model.proper_terms
    for friction, c in zip(extended.friction, terms, strict=False):
        if friction.probability > DECISIONS.likely:
            left_out = worth[c].log_evidence if c in worth else math.inf
            p = probability_of(friction.log_evidence - excess_evidence(friction.log_evidence, left_out))
            yield c, friction.log_evidence, Inclusion(p * friction.law, p, p, _laws(friction, c, extended))
    for term, c in zip(found.terms, extended.terms, strict=True):
        if not is_curve(c):
            own, rivals = limit_evidence(term.own, term.rivals, worth.get(c))
            yield c, term.own.log_evidence, inclusion(own, rivals, found.rows)


def _laws(friction: Friction, term: Candidate, extended: FinalModel) -> tuple[tuple[Hypothesis, float], ...]:
    """Return Coulomb friction that is the same in both directions, or is not, and how probable each is."""
    if friction.law == 1.0:
        return ()
    plus, minus = extended.found.fit.friction[term.site.joint, 1:]
    # The level is the machine's own already, see ``whole``.
    coefficients = {COULOMB: np.zeros(1), UNEVEN: np.array([0.0, 0.5 * (plus - minus)])}
    probability = {e: friction.law if e is term.effect else 1.0 - friction.law for e in coefficients}

    def hypothesis(e: Effect) -> Hypothesis:
        candidate = extended.model.columns.candidate(e, term.site, {})
        return Hypothesis(candidate, friction.log_evidence, coefficients[e], np.zeros(len(candidate.labels)), 1.0, 1)

    return tuple((hypothesis(e), p) for e, p in sorted(probability.items(), key=lambda pair: -pair[1]))


def places(robot: RobotModel, term: Candidate) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the joints that a term acts on and its links by name; none for the whole robot."""
    site, both = term.site, term.effect.whole_robot
    joints = tuple(robot.joint_names[j] for j in (site.joint, site.other if both else None) if j is not None)
    return joints, () if site.body is None else (robot.body_names[site.body],)


def likeliest_left(found: SearchOutcome) -> NextEffect | None:
    """Return what is likeliest given what was found, if it is likelier than not and the search ended before."""
    if found.complete or not found.last or log_odds(found.last[0], found.rows) <= 0.0:
        return None
    robot, c = found.rows.columns.robot, found.last[0].candidate
    joints, links = places(robot, c)
    recording = "" if c.site.window is None else c.site.window.recording
    return NextEffect(len(found.terms), c.effect.id, joints, links, driven_by(c, robot), recording)


def where(term: Candidate, columns: Columns, quantities: Mapping[str, Quantity], ends_s: Mapping[str, float]) -> Where:
    """Return when and in which range of a signal a term acts; ``ends_s`` are the lengths of the recordings."""
    robot, window, region = columns.robot, term.site.window, None
    bounds = term.effect.region({name: q.value for name, q in quantities.items()}, columns.scale(term.site))
    if bounds is not None and term.site.joint is not None:
        region = (Region(f"q_{robot.joint_names[term.site.joint]}", *bounds),)
    if window is None:
        return Where(term.site.recordings, region=region)
    whole = math.isinf(window.start_s) and math.isinf(window.end_s)
    span = round(max(window.start_s, 0.0), 2), round(min(window.end_s, ends_s[window.recording]), 2)
    return Where((window.recording,), None if whole else (span,), region)


def _finding(
    term: Candidate,
    evidence: float,
    sure: Inclusion,
    extended: FinalModel,
    ends_s: Mapping[str, float],
    alike: tuple[Alternative, ...],
) -> Finding:
    """Describe a term but for the errors without it and with it."""
    model = extended.model
    columns, robot = model.columns, model.columns.robot
    joints, links = places(robot, term)
    prismatic = term.site.joint is not None and bool(robot.prismatic[term.site.joint])
    wide = _std_left_open(term, extended)
    quantities = {
        name: Quantity(
            value, max(std, wide.get(name, 0.0)), term.effect.unit(name, prismatic=prismatic), columns.urdf_value(term)
        )
        for name, (value, std) in estimated_parameters(model, term).items()
        if name not in term.effect.follows
    }
    quantities |= {name: reciprocal(quantities[name]) for name in term.effect.reciprocals}
    return Finding(
        effect=term.effect.id,
        joints=joints,
        links=links,
        probability=min(sure.probability, DECISIONS.largest_probability),
        log_evidence_gain=evidence,
        parameters=quantities,
        where=where(term, columns, quantities, ends_s),
        indistinguishable_from=alike,
        nmse_before={},
        nmse_after={},
        depends_on=driven_by(term, robot),
        curve=fitted_curve(model, term),
        family=term.effect.family,
        family_probability=min(sure.family_probability, DECISIONS.largest_probability),
        class_probability=min(sure.class_probability, DECISIONS.largest_probability),
        laws=tuple(Law(h.candidate.effect.id, p) for h, p in sure.laws if p > DECISIONS.least_law),
        torque_rms=torque_rms(term, extended),
    )


def reciprocal(q: Quantity) -> Quantity:
    """Return a quantity that is one over a coefficient, such as a stiffness; a bound where that may be zero.

    The coefficient c = 1 / value is what the data know, and its interval. Where that holds zero the quantity has no
    upper end: it is at least 1 / (c + 1.645 std c), or infinite.
    """
    c, std = 1.0 / q.value, q.std / q.value**2
    if not math.isfinite(c) or abs(c) > _TWO_SIDED * std:
        return q
    return replace(q, value=math.nan, std=math.nan, at_least=1.0 / (max(c, 0.0) + _ONE_SIDED * std))


def reported(search: SearchResult, extended: FinalModel) -> Ranking:
    """Return a ranking whose adopted hypotheses have the parameters of the model that is reported."""
    final = {(c.effect.id, c.site): c for c in extended.terms}
    known = dict[tuple[object, ...], dict[str, float]]()
    ranked = search.ranking
    for one, term in zip(ranked.adopted, search.explanation.terms, strict=True):
        c = term.own.candidate
        now = final.get((c.effect.id, c.site))
        if now is not None:
            values = {n: Quantity(v, s, "") for n, (v, s) in estimated_parameters(extended.model, now).items()}
            values |= {name: reciprocal(values[name]) for name in c.effect.reciprocals}
            known[one.place] = {n: q.value for n, q in values.items() if n not in c.effect.follows}

    def of(several: Sequence[Ranked]) -> tuple[Ranked, ...]:
        return tuple(replace(one, parameters=known.get(one.place, one.parameters)) for one in several)

    return replace(ranked, first=of(ranked.first), adopted=of(ranked.adopted), last=of(ranked.last))


def _std_left_open(term: Candidate, extended: FinalModel) -> dict[str, float]:
    """Return the standard deviations of a term's parameters as the likelihood has them, its shape as it is."""
    if term not in extended.terms:
        return {}
    w, _ = extended.model.coefficients(term)

    def parameters(w: torch.Tensor) -> torch.Tensor:
        return torch.stack([*term.effect.parameters(w, term.shape).values()])

    J = torch.autograd.functional.jacobian(parameters, w)
    variance = ((J @ torch.from_numpy(extended.open[extended.terms.index(term)])) * J).sum(1)
    return dict(zip(term.effect.units, torch.nan_to_num(variance).clamp_min(0.0).sqrt().tolist(), strict=True))


def _alternatives(term: Candidate, sure: Inclusion, extended: FinalModel) -> tuple[Alternative, ...]:
    """Return the effects that cannot be distinguished from a term, the likeliest first, with their parameters."""
    model, fit, own = extended.model, extended.found.fit, (term.effect.id, replace(term.site, window=None))
    alike = [(h.candidate, whole(h.candidate, h.coefficients, fit.friction), p) for h, p in sure.laws if h.name != own]
    if UNEVENNESS in term.labels:
        # A constant torque, but for what happens within a reversal.
        (_, half) = model.x[model.columns.of(term)].numpy()
        alike.append((model.columns.candidate(OFFSET, term.site, {}), np.array([half]), 0.5))
    found = []
    for c, w, p in alike:
        if p > DECISIONS.least_law:
            values = {name: float(v) for name, v in c.effect.parameters(torch.from_numpy(w), c.shape).items()}
            where = (*places(model.columns.robot, c), driven_by(c, model.columns.robot))
            found.append(Alternative(c.effect.id, *where, values, p))
    return tuple(dict.fromkeys(found))


def torque_rms(term: Candidate, extended: FinalModel) -> dict[str, float]:
    """Return by joint the RMS of the torque that a term carries [N m or N], w' A w / n of its columns' moments A."""
    model, statistics = extended.model, extended.prepared.training
    found, own = {}, torch.zeros_like(model.x)
    own[model.columns.of(term)] = model.x[model.columns.of(term)]
    count = statistics.torque[..., 0].sum(0)
    for j, (columns, moments) in enumerate(zip(model.columns.of_joint, statistics.total(), strict=True)):
        power = float(own[columns] @ moments[:-1, :-1] @ own[columns])
        if power > 0:
            found[model.columns.robot.joint_names[j]] = math.sqrt(power / max(float(count[j]), 1e-300))
    return found
