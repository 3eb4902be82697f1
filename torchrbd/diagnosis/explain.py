"""Turn chosen terms into findings: how sure, what else it could be, what it is worth, and a sentence for a person."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from torchrbd.diagnosis.curves import driven_by, fitted_curve
from torchrbd.diagnosis.results import Alternative, Finding, Quantity, Region, Where
from torchrbd.diagnosis.rows.gain import Gain, gain
from torchrbd.diagnosis.rows.regression import Fit
from torchrbd.diagnosis.search.grid import freedom, fresh_columns
from torchrbd.diagnosis.search.options import BACKGROUND, Option, instead, judged
from torchrbd.diagnosis.search.partial import rivals
from torchrbd.diagnosis.search.select import Search, without
from torchrbd.diagnosis.search.unnamed import is_smooth
from torchrbd.diagnosis.words import finding_sentence, strongest_first
from torchrbd.inference.data.columns import Candidate, Columns
from torchrbd.inference.physical.fitting import FittedModel, judge
from torchrbd.inference.physical.terms import term_parameters
from torchrbd.inference.preparation import Prepared
from torchrbd.physics import Site
from torchrbd.robot import RobotModel

LARGEST_PROBABILITY = 0.999
# An alternative is told of if it is so many times as probable as the finding.
LEAST_ODDS = 0.05
LONGEST = 50.0
# Another effect competes with a term if it gains less than this part beside the term of what it gains without.
COMPETES = 0.5
# A term of which less than this is left beside another effect is a case of that one, which says no other thing.
CONTAINED = 1e-3
# Viscous and Coulomb friction and an offset, at all times, are found on every robot: log of how much more often than
# anything else.
PLAIN = 4.0


@dataclass(frozen=True)
class Rival:
    """Another effect in the place of a finding, and how many times as probable it is."""

    candidate: Candidate
    odds: float


@dataclass(frozen=True)
class Weighed:
    """A term, what it gains over none, and its rivals."""

    term: Candidate
    worth: Gain
    rivals: tuple[Rival, ...]

    @property
    def probability(self) -> float:
        """Of the term, against none and each of its rivals."""
        total = odds(self.worth, 0.0) + sum(r.odds for r in self.rivals)
        return min(1.0 / (1.0 + total), LARGEST_PROBABILITY)


def weigh(search: Search, fit: Fit) -> tuple[Weighed, ...]:
    """Compare every term of a fit with none and with others in its place, fitted and with refined shapes."""
    found, counts = [], fit.rows.counts
    for term in fit.terms:
        rest = instead(fit, without(fit.terms, term), term)
        own, alike = judged(rest, term), []
        for option in rivals(search, rest, term):
            c = option.candidate
            if (c.effect.id, c.site) != (term.effect.id, term.site) and _competes(fit, rest, term, option):
                more = freedom(rest, c) - freedom(rest, term)
                more += PLAIN * (_is_plain(term) - _is_plain(c))
                alike.append(Rival(c, odds(gain(option.errors, own.errors, counts), more)))
        found.append(Weighed(term, own.worth, tuple(alike)))
    return tuple(found)


def _is_plain(term: Candidate) -> bool:
    return term.site.always and term.effect.id in BACKGROUND


def _competes(fit: Fit, rest: Fit, term: Candidate, option: Option) -> bool:
    """Say whether an option explains what a term explains: it gains little beside it, and does not contain it.

    What pushes a link for a while contains an offset of its joint, but is another cause.
    """
    C = fresh_columns(fit, option.candidate)
    if C.shape[1] and judged(fit, option.candidate).worth.total > COMPETES * option.worth.total:
        return False
    if not term.site.always and option.candidate.place != term.place:
        return True
    other = Fit(fit.rows, (*rest.terms, option.candidate))
    return other.share_left(fit.rows.columns(term)[1]) > CONTAINED


def odds(lead: Gain, freedom: float) -> float:
    """Return how many times as probable a model is as another that has a lead over it on left-out blocks.

        o = exp(-F) max(exp(-G), min(exp(-t^2 / 2), exp(-R))),   t = G / std(G)

    with F the cost of what the model is freer than the other. The ratio is that of the likelihoods, but never longer
    than the blocks support: their scatter, or what is left of the lead without the best two of them (R). Correlated
    noise and other physics left out make the likelihood overconfident.
    """
    scatter = min(math.exp(-0.5 * max(lead.t, 0.0) ** 2), math.exp(-max(lead.repeated, 0.0)))
    return math.exp(min(-freedom, LONGEST)) * max(math.exp(min(-lead.total, LONGEST)), scatter)


def explain(prepared: Prepared, weighed: Sequence[Weighed], model: FittedModel) -> tuple[Finding, ...]:
    """Describe each chosen term.

    Args:
        prepared: the data.
        weighed: the terms as the search left them.
        model: the fit with the same terms, in the same order, their shapes final.

    Returns:
        Findings, those likelier than not first, then by gain; rivals the likeliest first.
    """
    judging, reading = prepared.judging, prepared.reading
    ends_s = {r.name: s.segments[-1][1] for r, s in zip(reading.recordings, reading.surveys, strict=True)}
    after, found = judge(judging, model.x).nmse, []
    # The first of the model's terms are those of the search; plain friction too little to be found may follow.
    terms = model.proper_terms[: len(weighed)]
    everywhere = {(c.effect, c.site) for c in terms}
    for one, term in zip(weighed, terms, strict=True):
        if is_smooth(term):
            continue
        rest = [c for c in model.terms if c is not term]
        before = judge(judging, prepared.fit(rest, model.noise_variance).x).nmse
        finding = _finding(one, term, model, before, after, ends_s)
        more = term.site.recordings is not None and (term.effect, replace(term.site, recordings=None)) in everywhere
        found.append(replace(finding, statement=finding_sentence(finding, more=more)))
    return strongest_first(found)


def places(robot: RobotModel, site: Site) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the joints and the links of a site by name; none for the whole robot."""
    joints = () if site.joint is None else (robot.joint_names[site.joint],)
    return joints, () if site.body is None else (robot.body_names[site.body],)


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
    one: Weighed,
    term: Candidate,
    model: FittedModel,
    before: Mapping[str, float],
    after: Mapping[str, float],
    ends_s: Mapping[str, float],
) -> Finding:
    columns, robot = model.columns, model.columns.robot
    joints, links = places(robot, term.site)
    prismatic = term.site.joint is not None and bool(robot.prismatic[term.site.joint])
    quantities = {
        name: Quantity(value, std, term.effect.unit(name, prismatic=prismatic), columns.urdf_value(term))
        for name, (value, std) in term_parameters(model, term).items()
    }
    alike = tuple(
        Alternative(r.candidate.effect.id, *places(robot, r.candidate.site), driven_by(r.candidate, robot))
        for r in sorted(one.rivals, key=lambda r: -r.odds)
        if r.odds > LEAST_ODDS
    )
    touched = joints if term.place is not None else tuple(robot.joint_names)
    return Finding(
        effect=term.effect.id,
        joints=joints,
        links=links,
        probability=one.probability,
        log_evidence_gain=one.worth.total,
        parameters=quantities,
        where=where(term, columns, quantities, ends_s),
        indistinguishable_from=tuple(dict.fromkeys(alike)),
        nmse_before={name: value for name, value in before.items() if name in touched},
        nmse_after={name: value for name, value in after.items() if name in touched},
        statement="",
        depends_on=driven_by(term, robot),
        curve=fitted_curve(model, term),
    )
