"""Diagnose: fit the rigid body, find what it leaves out, extend the model, and say what remains."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from torchrbd._runtime.deadline import time_limited
from torchrbd._runtime.threads import single_threaded
from torchrbd.dataset.reading import Progress
from torchrbd.diagnosis.clock_offset import clock_offset
from torchrbd.diagnosis.deflection import joint_deflections
from torchrbd.diagnosis.detection_limits import detection_limits
from torchrbd.diagnosis.diagnosis import Diagnosis
from torchrbd.diagnosis.explain import explain, likeliest_left, reported
from torchrbd.diagnosis.final_model import FinalModel, fit_final_model
from torchrbd.diagnosis.held_out_checks import held_out_checks, held_out_ratio
from torchrbd.diagnosis.localisation import locate
from torchrbd.diagnosis.posterior import refit_matters
from torchrbd.diagnosis.proof import predicts_nothing
from torchrbd.diagnosis.ranking import run_search
from torchrbd.diagnosis.results import Finding, Ratio, Unexplained, strongest_first
from torchrbd.diagnosis.springs import with_springs
from torchrbd.diagnosis.stability import check_repetitions, with_stability
from torchrbd.diagnosis.suspect import suspect
from torchrbd.diagnosis.unexplained import drifts, large_errors, merge_errors, unexplained
from torchrbd.errors import OptionError
from torchrbd.estimators import OF_RECORDINGS
from torchrbd.inference.identify import marked, read_arguments, summarise
from torchrbd.inference.ordinary import with_friction, with_machine
from torchrbd.inference.preparation import prepare
from torchrbd.inference.suspicions import suspicions
from torchrbd.options import Names, Payload, given
from torchrbd.recordings import Sources
from torchrbd.robot import RobotModel


@time_limited
@single_threaded()
def diagnose(
    robot: RobotModel | str | Path | bytes,
    recordings: Sources,
    *,
    holdout: Sources = (),
    holdout_fraction: float = 0.25,
    time: str | tuple[float, float] | None = None,
    joints: Names | None = None,
    effects: Names | None = None,
    exclude: Names = (),
    gravity: Sequence[float] | None = None,
    trust: Names = (),
    payload: Sequence[Payload | str] | Payload | str = (),
    simulated: Sources = (),
    mapping: str | Path | None = None,
    cutoff_hz: float | None = None,
    estimator: str = "auto",
    encoder_noise: float | Mapping[str, float] | None = None,
    kappa: float = 3.0,
    seed: int = 0,
    time_limit: float | str | None = None,
    stability: int = 0,
    progress: Progress = lambda *_: None,
) -> Diagnosis:
    """Find the physics that a robot's URDF leaves out.

    Args:
        robot: a robot or its URDF.
        recordings: files, opened recordings or data in memory, as for ``identify``.
        holdout: recordings that no fit uses; the reported errors are those on them. In Python, files, opened recordings
            or data in memory. Default: none; a part of each recording is held out, see ``holdout_fraction``.
        holdout_fraction: without ``holdout``, the part of each recording that is held out, (0, 0.5]. Default: 0.25.
        time: use only this part of each recording, FROM:TO [s] from its start, e.g. 2:30. In Python, text or a pair of
            numbers. Default: all.
        joints: joints whose torque counts, by name. Default: all.
        effects: effects to fit (``diagnose``: to search among), by id at all their places, or as EFFECT@PLACE. A place
            is a joint, a pair such as joint3_joint1, or a link. EFFECT@PLACE@RECORDING=FROM:TO [s] acts for a time
            only. In Python, ``torchrbd.known_effects()`` lists the ids, and [] is the rigid body alone. Default: of
            ``diagnose`` all, of ``compare_estimators`` none, else viscous and Coulomb friction and a torque offset.
        exclude: effects not to use, by id. Default: none.
        gravity: acceleration in the base's axes, X Y Z [m/s^2], e.g. 0 9.81 0 for an arm on a wall. In Python, only
            with a robot that is given by its URDF. Default: 0 0 -9.81.
        trust: links whose inertia is not fitted again, by name. Default: none.
        payload: known loads, FILE=kg,x,y,z[@LINK]: mass [kg] and centre of mass [m] in the frame of a link. In Python,
            text or ``torchrbd.inference.Payload``. Default: none; of a chain, the link is the last one.
        simulated: recordings of a simulator with the same commands: one for each recording, then one for each of
            ``holdout``, in their order. The robot is compared with them in place of the URDF. Where the simulator has
            other inertials than the URDF, the difference is reported as inertial parameters. Default: none.
        mapping: YAML file with other column names, units, signs, gear ratios or torque constants. Default: columns t,
            q_<joint>, tau_<joint> in SI units.
        cutoff_hz: band limit of torque and features [Hz]. Default: chosen from the data.
        estimator: how parameters are estimated. In Python, ``torchrbd.estimators.ESTIMATORS`` lists the names. Default:
            auto.
        encoder_noise: standard deviation of the positions [rad, m], one number or JOINT=number for each. In Python, a
            number or {joint: number}. Default: estimated.
        kappa: weight of the URDF's inertia against the data, above 0. Default: 3.
        seed: which blocks of time are held out, a whole number. Default: 0.
        time_limit: seconds, or text such as 90s or 2min, after which the search ends; the best model so far is then
            fitted, judged, written and marked as unfinished. Reading, learning the noise and reporting are not cut
            short. Default: none.
        stability: how often to repeat the search with blocks of time that are weighted at random (a bootstrap); each
            finding then has the share of repetitions that find it again. One takes about as long as the search.
            Default: 0.
        progress: called with the stage and the part of it that is done.

    Raises:
        InputError: a robot, recording or option that cannot be used.
    """
    check_repetitions(stability)
    robot, sources, settings = read_arguments(robot, recordings, given(locals()), "diagnose")
    if settings.estimator not in OF_RECORDINGS:
        raise OptionError(
            f"diagnose: estimator '{settings.estimator}' has no intervals, which the search must know; "
            f"use {', '.join(OF_RECORDINGS)}, or identify"
        )
    prepared = prepare(robot, sources, settings, (), progress)
    progress("looking for wrong units and columns", 0.0)
    suspected = suspicions(prepared)
    if suspected.settles:
        return suspect(prepared, settings, progress, suspected)
    search = run_search(prepared.reading, settings, prepared.kept_back, progress)
    found, may = search.explanation, [e.id for e in settings.chosen_effects()]
    laws = [term.own.candidate for term in found.terms if term.own.candidate.effect.family == "friction"]
    asked = prepared
    prepared = with_machine(prepared, settings, with_friction(settings, sources), progress, search.clocks, laws)
    progress("fitting what was found", 0.0)
    model = fit_final_model(prepared, found, may, progress)
    if predicts_nothing(model.prepared, model.model) and predicts_nothing(
        asked, asked.fit(asked.columns.urdf_friction)
    ):
        return suspect(asked, settings, progress, suspected, search.ranking)
    explained = explain(model)
    findings, not_confirmed, model = explained.findings, explained.not_confirmed, explained.model
    if stability:
        stage = "repeating the search"
        findings = with_stability(
            findings,
            search.explanation,
            settings.chosen_effects(),
            stability,
            settings.seed,
            lambda part: progress(stage, part),
        )
    found = model.found
    models = {"rigid_body": model.prepared.fit(), "extended": model.model}
    identification = summarise(model.prepared, models, settings, progress, suspected)
    springs = joint_deflections(model.prepared, model.model)
    late = clock_offset(search.ranking, model, identification)
    if late is not None and late.confirmed:
        findings = strongest_first((*findings, late))
    elif late is not None:
        not_confirmed = strongest_first((*not_confirmed, late))
    findings = with_springs(findings, springs)
    proof = held_out_checks(identification.series, identification.cutoff_hz)
    nameless = (*unexplained(model, explained.curves), *drifts(identification.series, identification.robot))
    explained_joints = {joint for one in (*findings, *nameless) for joint in one.joints}
    rest = merge_errors((*nameless, *large_errors(identification.series, proof, explained_joints)))
    progress("locating residuals", 0.0)
    locations, maps = locate(found, lambda part: progress("locating residuals", part))
    identification = marked(identification)
    verdict = _verdict(findings, rest, refit_matters=refit_matters(found.base))
    simulations = tuple(one.name for one in prepared.reading.simulated)
    absent = detection_limits(found)
    return Diagnosis(
        identification,
        verdict,
        findings,
        rest,
        locations,
        maps,
        absent,
        springs,
        simulations,
        proof,
        ranking=reported(search, model),
        not_confirmed=not_confirmed,
        held_out_ratio=_shown_on_held_out(model) if findings else None,
        next_effect=likeliest_left(search.explanation),
    )


def _shown_on_held_out(final: FinalModel) -> Ratio | None:
    """Return the size on held-out data of what a model adds to one with baseline friction, see ``held_out_ratio``."""
    prepared = final.prepared
    return held_out_ratio(prepared.judging, final.model, prepared.fit(prepared.columns.urdf_friction).x)


def _verdict(findings: Sequence[Finding], rest: Sequence[Unexplained], *, refit_matters: bool) -> str:
    if findings:
        return "missing_physics"
    if rest:
        return "unexplained"
    return "parameters" if refit_matters else "consistent"
