"""Diagnose: fit the rigid body, find what it leaves out, extend the model, and say what remains."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from torchrbd.diagnosis.alternatives import Weighed, weigh
from torchrbd.diagnosis.beside import fit_beside, plain_beside
from torchrbd.diagnosis.deflection import deflections
from torchrbd.diagnosis.explain import explain
from torchrbd.diagnosis.limits import limits
from torchrbd.diagnosis.locate import hums, locate, shock_notes, shocks, wanders
from torchrbd.diagnosis.nameless import nameless
from torchrbd.diagnosis.proof import doubt, proofs
from torchrbd.diagnosis.ranking import Ranking, ranking
from torchrbd.diagnosis.refuting import refuted
from torchrbd.diagnosis.results import Diagnosis, Finding, Unexplained
from torchrbd.diagnosis.rows.gain import gain
from torchrbd.diagnosis.rows.regression import Fit
from torchrbd.diagnosis.rows.samples import read_samples
from torchrbd.diagnosis.rows.shocks import without_shocks
from torchrbd.diagnosis.search.options import accepted
from torchrbd.diagnosis.search.select import Search
from torchrbd.diagnosis.search.terms import Terms, names
from torchrbd.diagnosis.search.unnamed import proper
from torchrbd.diagnosis.springs import with_springs
from torchrbd.diagnosis.verdict_words import verdict_statement
from torchrbd.errors import InputError, OptionError
from torchrbd.estimators import WITH_INTERVALS
from torchrbd.inference.identify import Source, read_arguments, summarise
from torchrbd.inference.physical.fitting import FittedModel
from torchrbd.inference.preparation import Prepared, prepare
from torchrbd.inference.settings import Settings
from torchrbd.inference.shapes.refine import refined_from
from torchrbd.inference.shapes.reread import judged_at_shocks, reread
from torchrbd.likelihood.reading import Progress
from torchrbd.physics import Effect
from torchrbd.robot import RobotModel
from torchrbd.threads import single_threaded


class _Explanation(NamedTuple):
    """What of a search stands in the fit to all data that is not held out."""

    search: Search
    fit: Fit
    prepared: Prepared
    model: FittedModel
    weighed: tuple[Weighed, ...]


@single_threaded()
def diagnose(
    robot: RobotModel | str | Path | bytes,
    recordings: Sequence[Source] | Source,
    *,
    progress: Progress = lambda *_: None,
    **options: Any,
) -> Diagnosis:
    """Find the physics that a robot's URDF leaves out.

    Args:
        robot: a robot or its URDF.
        recordings: files or opened recordings.
        progress: told how far the work is.
        **options: those of ``identify``; ``effects`` are those that the search may use, all by default.

    Raises:
        InputError: a robot, recording or option that cannot be used.
    """
    robot, sources, settings = read_arguments(robot, recordings, options, "diagnose")
    if settings.estimator not in WITH_INTERVALS:
        raise OptionError(
            f"diagnose: estimator '{settings.estimator}' does not tell how sure it is, which the search must know; "
            f"use {', '.join(WITH_INTERVALS)}, or identify"
        )
    effects = settings.chosen_effects()
    prepared = prepare(robot, sources, settings, (), progress)
    search, fit, prepared, extended, weighed = _explained(prepared, effects, progress)
    prepared = judged_at_shocks(replace(prepared, notes=(*prepared.notes, *shock_notes(fit))), progress)
    models = {"rigid_body": prepared.fit(), "extended": extended}
    ranked, why_not = _ranked(prepared, settings, progress)
    identification = summarise(replace(prepared, notes=(*prepared.notes, *why_not)), models, settings, progress)
    springs = deflections(prepared, extended)
    findings = with_springs(explain(prepared, weighed, extended), springs)
    progress("looking at what is left", 0.0)
    locations, maps = locate(search.start)
    # Plain friction that is too little to be found shall not be located as unexplained either.
    left, more = locate(search.with_background(fit), "extended")
    left = (*left, *hums(fit, "extended"), *wanders(fit, "extended"), *shocks(fit, "extended"))
    rest = nameless(fit, extended, left)
    verdict = _verdict(findings, rest, _refit_matters(fit))
    simulated = tuple(one.name for one in prepared.reading.simulated)
    model = "simulation" if simulated else "URDF"
    statement = verdict_statement(verdict, findings, rest, identification.fits, model)
    absent = limits(search, fit)
    where = (*locations, *left), (*maps, *more)
    proof = proofs(identification.series, identification.cutoff_hz)
    statement = " ".join(filter(None, (statement, doubt(proof, findings))))
    return Diagnosis(
        identification, verdict, statement, findings, rest, *where, absent, springs, simulated, proof, ranking=ranked
    )


def _ranked(prepared: Prepared, settings: Settings, progress: Progress) -> tuple[Ranking | None, tuple[str, ...]]:
    """Rank all hypotheses on what is not held out; where that cannot be done, return why not, and none."""
    try:
        return ranking(prepared.reading, settings, prepared.kept_back, progress), ()
    except (InputError, np.linalg.LinAlgError) as error:
        return None, (f"what was considered is not ranked: {error}",)


def _explained(prepared: Prepared, effects: Sequence[Effect], progress: Progress) -> _Explanation:
    """Search among effects, on what is not held out, and extend the model; without shocks if they spoil what was found.

    They count all the same where they tell a name: it is found with them and without, and stands with them alone.
    """
    robot = prepared.robot

    def tell(found: Terms) -> None:
        last = f": {found[-1].effect.words} at {found[-1].site.name(robot)}" if found else ""
        progress(f"searching for missing physics, {len(found)} terms{last}", 0.0)

    progress("searching for missing physics", 0.0)
    samples = read_samples(prepared, prepared.fit().pi)
    search = Search(samples, effects, prepared.prior, tell)
    fit = search.run()
    levels = without_shocks(fit).rows.samples.columns.shock_levels
    if levels.isinf().all():
        return _extended(prepared, search, fit, progress)
    calm = Search(samples.without_shocks(levels), effects, prepared.prior, tell)
    calm_fit = calm.run()
    extended = _extended(prepared, calm, calm_fit, progress)
    found, found_calm, stand = (set(names(proper(f.terms))) for f in (fit, calm_fit, extended.fit))
    refuted_without = found & found_calm - stand
    if not refuted_without:
        return extended
    shocked = _extended(prepared, search, fit, progress)
    return shocked if refuted_without.intersection(names(shocked.fit.terms)) else extended


def _extended(prepared: Prepared, search: Search, fit: Fit, progress: Progress) -> _Explanation:
    """Fit what was found to all that is not held out: physically valid, shapes as fine as the data tells.

    Plain friction that was too little to be found is fitted beside it.

    Where a term has parameters then that no physics allows, or that may as well be zero, or others in its place are far
    likelier, the search goes on without it.
    """
    while True:
        terms: Terms = (*fit.terms, *plain_beside(search, fit))
        columns = fit.rows.samples.columns.of_candidates(terms, fit.pi)
        prepared, terms = refined_from(reread(prepared, columns, progress), terms, progress)
        found = terms[: len(fit.terms)]
        model = fit_beside(prepared, found, terms[len(found) :])
        wrong = refuted(model, found)
        if not wrong:
            progress("weighing the findings", 0.0)
            weighed = weigh(search, fit)
            wrong = [one.term for one in weighed if one.unlikely]
            if not wrong:
                return _Explanation(search, fit, prepared, model, weighed)
        fit = search.without(fit, wrong)


def _refit_matters(fit: Fit) -> bool:
    """Say whether re-fitted inertial parameters predict unseen blocks better than the URDF's."""
    rows = fit.rows
    return accepted(gain(fit.by_block(rows.y), Fit(rows, ()).errors, rows.counts))


def _verdict(findings: Sequence[Finding], rest: Sequence[Unexplained], refit_matters: bool) -> str:
    if findings:
        return "missing_physics"
    if rest:
        return "unexplained"
    return "parameters" if refit_matters else "consistent"
