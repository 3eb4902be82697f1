"""Turn chosen terms into findings: how sure, what else it could be, what it is worth, and a sentence for a person."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

from torchrbd.diagnosis.alternatives import Weighed
from torchrbd.diagnosis.curves import driven_by, fitted_curve
from torchrbd.diagnosis.results import Alternative, Finding, Quantity, Region, Where
from torchrbd.diagnosis.search.unnamed import is_smooth
from torchrbd.diagnosis.words import finding_sentence, strongest_first
from torchrbd.inference.physical.fitting import FittedModel, judge
from torchrbd.inference.physical.terms import told_parameters
from torchrbd.inference.preparation import Prepared
from torchrbd.likelihood.columns import Candidate, Columns
from torchrbd.physics import Site
from torchrbd.robot import RobotModel

# An alternative is told of if it is so many times as probable as the finding.
LEAST_ODDS = 0.05


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
        for name, (value, std) in told_parameters(model, term).items()
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
