"""Diagnose: fit the rigid body, find what it leaves out, extend the model, and say what remains."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from torchrbd.diagnosis.clock_offset import clock_offset
from torchrbd.diagnosis.deflection import deflections
from torchrbd.diagnosis.explain import explain, likeliest_left
from torchrbd.diagnosis.extending import Extended, extended
from torchrbd.diagnosis.limits import limits
from torchrbd.diagnosis.locate import locate
from torchrbd.diagnosis.posterior import refit_matters
from torchrbd.diagnosis.proof import doubt, proofs
from torchrbd.diagnosis.ranking import ranking, without_terms
from torchrbd.diagnosis.refuting import friction_alone, functions_alone, is_refuted, shown_of, what_counts
from torchrbd.diagnosis.results import Diagnosis, Finding, LeftoverMap, Location, Unexplained
from torchrbd.diagnosis.rows.regression import fitted
from torchrbd.diagnosis.rows.samples import read_samples
from torchrbd.diagnosis.rows.weighing import weighed
from torchrbd.diagnosis.springs import with_springs
from torchrbd.diagnosis.suspect import suspect, tells_nothing
from torchrbd.diagnosis.trifling import is_trifling
from torchrbd.diagnosis.unexplained import only_where_fitted, tones, unexplained
from torchrbd.diagnosis.verdict_words import REFUTED, ended_statement, verdict_statement
from torchrbd.diagnosis.words import strongest_first
from torchrbd.effects import Site, effect
from torchrbd.effects.registry import PLAIN
from torchrbd.errors import OptionError
from torchrbd.estimators import OF_RECORDINGS
from torchrbd.inference.identify import read_arguments, summarise
from torchrbd.inference.ordinary import with_friction, with_machine
from torchrbd.inference.preparation import Prepared, prepare
from torchrbd.inference.suspicions import suspicions
from torchrbd.likelihood.reading import Progress
from torchrbd.recordings import RecordingSource
from torchrbd.robot import RobotModel
from torchrbd.threads import single_threaded


@single_threaded()
def diagnose(
    robot: RobotModel | str | Path | bytes,
    recordings: Sequence[RecordingSource] | RecordingSource,
    *,
    progress: Progress = lambda *_: None,
    **options: Any,
) -> Diagnosis:
    """Find the physics that a robot's URDF leaves out.

    Args:
        robot: a robot or its URDF.
        recordings: files, opened recordings or data in memory, as for ``identify``.
        progress: told how far the work is.
        **options: those of ``identify``; ``effects`` are those that the search may use, all by default.

    Raises:
        InputError: a robot, recording or option that cannot be used.
    """
    robot, sources, settings = read_arguments(robot, recordings, options, "diagnose")
    if settings.estimator not in OF_RECORDINGS:
        raise OptionError(
            f"diagnose: estimator '{settings.estimator}' does not tell how sure it is, which the search must know; "
            f"use {', '.join(OF_RECORDINGS)}, or identify"
        )
    prepared = prepare(robot, sources, settings, (), progress)
    progress("looking for wrong units and columns", 0.0)
    suspected = suspicions(prepared)
    if suspected.settles:
        return suspect(prepared, settings, progress, suspected)
    ranked = ranking(prepared.reading, settings, prepared.kept_back, progress)
    found, may = ranked.explanation, [e.id for e in settings.chosen_effects()]
    asked, prepared = prepared, with_machine(prepared, settings, with_friction(settings), progress, ranked.clocks)
    progress("fitting what was found", 0.0)
    model = extended(prepared, found, may, progress)
    worthless = tells_nothing(model.prepared, model.model)
    if worthless and tells_nothing(asked, asked.fit(asked.columns.urdf_friction)):
        return suspect(asked, settings, progress, suspected, ranked)
    told, alone, base = explain(model), (), ranked
    full, plainly = told.model, worthless or is_refuted(told, asked)
    if plainly and told.apart and not worthless:
        # Bodies and friction may have taken the other side of what is set apart.
        told = what_counts(told)
        plainly = not told.model.terms or is_refuted(told, asked)
    if plainly:
        base = without_terms(ranked, settings.chosen_effects())
        told = friction_alone(asked, told, base, settings, progress)
        alone = (*tones(found), *(() if worthless else functions_alone(asked, ranked, settings, progress)))
    there = None if plainly else shown_of(told.model)
    findings, trifling, model = told.findings, told.trifling, told.model
    models = {"rigid_body": model.prepared.fit(), "extended": model.model}
    identification = summarise(model.prepared, models, settings, progress, suspected)
    springs = deflections(model.prepared, model.model)
    late = clock_offset(base, model, identification)
    if late is not None and is_trifling(late, model):
        trifling = strongest_first((*trifling, late))
    elif late is not None:
        findings = strongest_first((*findings, late))
    findings = with_springs(findings, springs)
    proof = proofs(identification.series, identification.cutoff_hz)
    rest = (*alone, *unexplained(model, () if plainly else findings, proof))
    if plainly:
        known = {joint for one in rest for joint in one.joints}
        rest = (*rest, *(one for one in only_where_fitted(full, model) if one.joints[0] not in known))
    progress("looking at what is left", 0.0)
    locations, maps = _located(prepared, model)
    verdict = _verdict(findings, rest, refit_matters=refit_matters(found.base))
    simulated = tuple(one.name for one in prepared.reading.simulated)
    compared = "simulation" if simulated else "URDF"
    there = there if findings else None
    statement = verdict_statement(verdict, findings, rest, identification.fits, compared, there)
    ended = ended_statement(len(found.terms), likeliest_left(found))
    refutes = REFUTED if plainly else ""
    statement = " ".join(filter(None, (statement, refutes, ended, doubt(proof, findings, there))))
    absent = limits(found)
    return Diagnosis(
        identification,
        verdict,
        statement,
        findings,
        rest,
        locations,
        maps,
        absent,
        springs,
        simulated,
        proof,
        ranking=ranked,
        trifling=trifling,
        confirmed=there,
    )


def _located(prepared: Prepared, model: Extended) -> tuple[tuple[Location, ...], tuple[LeftoverMap, ...]]:
    """Return where the rigid body with ordinary friction, and the extended model, differ from the robot."""
    samples = read_samples(prepared, prepared.fit().pi)
    seen = [j for j in range(prepared.robot.n_dof) if samples.seen[j]]
    plain = tuple(samples.columns.candidate(effect(name), Site(j), {}) for j in seen for name in PLAIN)
    before = weighed(fitted(samples, prepared.prior, plain))
    first = locate(before)
    after = locate(fitted(samples, prepared.prior, (*plain, *model.terms), before.rows.noise), "extended")
    return (*first[0], *after[0]), (*first[1], *after[1])


def _verdict(findings: Sequence[Finding], rest: Sequence[Unexplained], *, refit_matters: bool) -> str:
    if findings:
        return "missing_physics"
    if rest:
        return "unexplained"
    return "parameters" if refit_matters else "consistent"
