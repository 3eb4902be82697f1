"""Identify a robot: prepare, fit, judge, and collect what a person or a report wants to know."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from torchrbd._runtime.deadline import reached_limit_s, stopped, time_limited
from torchrbd._runtime.threads import single_threaded
from torchrbd.dataset.reading import Progress
from torchrbd.dataset.simulated import motion_doubts
from torchrbd.display import Remark
from torchrbd.errors import OptionError
from torchrbd.estimators import WITH_INTERVALS
from torchrbd.inference.baseline import fit_baseline
from torchrbd.inference.data.bodies import fixed_base
from torchrbd.inference.estimators import estimate
from torchrbd.inference.identification import Identification
from torchrbd.inference.ordinary import drop_rotors_without_drive, with_friction, with_machine
from torchrbd.inference.parameter_estimates import base_estimates, inertial_estimates, values_alone
from torchrbd.inference.physical.fitting import FittedModel, judge, term_candidates
from torchrbd.inference.physical.terms import term_estimates
from torchrbd.inference.posterior.posterior import Posterior
from torchrbd.inference.preparation import Prepared, prepare
from torchrbd.inference.results import JointNoise, TorqueSeries
from torchrbd.inference.series import held_out_spans, torque_series
from torchrbd.inference.settings import Settings
from torchrbd.inference.shapes.places import check_seen
from torchrbd.inference.shapes.refine import fit_with_shapes, refined
from torchrbd.inference.statistics.preparing import MOMENTS, of_moments, prepare_moments
from torchrbd.inference.suspicions import NO_SUSPICIONS, Suspicions, suspicions, with_late_torque
from torchrbd.inference.torque_error import Fit
from torchrbd.inference.verdict import doubts_of, encoder_doubts, regime_of, tells_nothing, verdict_of
from torchrbd.model import Reported, RigidBodyDynamics, described_terms
from torchrbd.options import Names, Payload, given
from torchrbd.parameters import base_parameters
from torchrbd.recordings import Filtering, NamedSource, Sources, listed_sources
from torchrbd.robot import RobotModel
from torchrbd.simulation import ClosedLoop, MotionErrors, closed_loop, motion_errors


@time_limited
@single_threaded()
def identify(
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
    progress: Progress = lambda *_: None,
) -> Identification:
    """Fit a robot's inertial parameters to recordings; the result is always physically valid.

    Args:
        robot: a robot or its URDF.
        recordings: files, opened recordings, or data in memory as ``open_recording`` takes them: tables such as a
            ``pandas.DataFrame``, dicts of arrays. Those in memory are called "recording 1" by their place in the list.
            Or files of statistics, see ``write_statistics``.
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
        progress: called with the stage and the part of it that is done.

    Raises:
        InputError: a robot, recording or option that cannot be used.

    Example:
        >>> import pandas as pd, torchrbd
        >>> monday = pd.read_feather("monday.feather")  # columns t, q_joint1, tau_joint1, ...
        >>> tuesday = {"t": t, "q": q, "tau": tau}  # (N,) and twice (N, n), joints in the robot's order
        >>> found = torchrbd.identify("robot.urdf", [monday, "sunday.csv"], holdout=tuesday)
        >>> found.recordings, found.held_out
        (('recording 1', 'sunday.csv'), 'held-out recording 1')
    """
    robot, sources, settings = read_arguments(robot, recordings, given(locals()), "identify")
    if of_moments(sources, settings):
        return _by_moments(robot, sources, replace(settings, estimator=MOMENTS), progress)
    fitted = with_friction(settings, sources)
    prepared = prepare(robot, sources, settings, fitted, progress)
    progress("looking for wrong units and columns", 0.0)
    suspected = suspicions(prepared)
    prepared = with_machine(prepared, settings, fitted, progress)
    terms = drop_rotors_without_drive(prepared, settings, term_candidates(prepared.columns, [e.id for e in fitted]))
    check_seen(settings.requested_effects(), prepared.columns)
    prepared, terms = refined(prepared, terms, progress)
    progress("fitting", 0.0)
    models = {"rigid_body": prepared.fit()}
    if fitted:
        sure = settings.estimator in WITH_INTERVALS
        models["extended"] = fit_with_shapes(prepared, terms) if sure else prepared.fit(terms)
    if settings.estimator not in WITH_INTERVALS:
        prepared, models = _estimated(prepared, settings.estimator, models)
    return marked(summarise(prepared, models, settings, progress, suspected))


def marked(found: Identification) -> Identification:
    """Return an identification that says so if its search was ended early."""
    if not stopped():
        return found
    return replace(found, finished=False, facts=(Remark("unfinished", {"limit_s": reached_limit_s()}), *found.facts))


def _by_moments(
    robot: RobotModel, sources: Sequence[NamedSource], settings: Settings, progress: Progress
) -> Identification:
    """Fit to second moments alone."""
    prepared = prepare_moments(robot, sources, settings, progress)
    progress("fitting", 0.0)
    models = {"rigid_body": prepared.fit()}
    terms = term_candidates(prepared.columns, [e.id for e in prepared.columns.effects])
    if terms:
        models["extended"] = prepared.fit(terms)
    return summarise(prepared, models, settings, progress)


def read_arguments(
    robot: RobotModel | str | Path | bytes,
    recordings: Sources,
    options: Mapping[str, Any],
    place: str,
) -> tuple[RobotModel, list[NamedSource], Settings]:
    """Return robot, list of recordings and checked settings of a call; ``place`` is named in errors."""
    settings = Settings.from_mapping(options, place)
    if not isinstance(robot, RobotModel):
        robot = RobotModel.from_urdf(robot, gravity=settings.gravity)
    elif settings.gravity is not None:
        raise OptionError(f"{place}: a RobotModel has its own gravity; give it to RobotModel.from_urdf")
    return robot, listed_sources(recordings), settings


def _estimated(
    prepared: Prepared, name: str, models: Mapping[str, FittedModel]
) -> tuple[Prepared, dict[str, FittedModel]]:
    """Return the models with the coefficients of another estimator, nothing known of their errors, and notes on it."""
    found, facts = {}, list[Remark]()
    for key, model in models.items():
        one = estimate(prepared, name, model.terms)
        unknown = torch.full_like(model.covariance, torch.nan)
        left = prepared.training.squared_error(one.x).sum(0) / prepared.training.torque[..., 0].sum(0)
        found[key] = replace(model, x=one.x, laplace=unknown, covariance=unknown, noise_variance=left, converged=True)
        values = {"estimator": name, "was_physical": one.was_physical, "with_intervals": [*WITH_INTERVALS]}
        facts = [Remark("no intervals", values), *filter(None, [one.remark])]
    return replace(prepared, facts=(*prepared.facts, *facts)), found


def summarise(
    prepared: Prepared,
    models: dict[str, FittedModel],
    settings: Settings,
    progress: Progress,
    suspected: Suspicions = NO_SUSPICIONS,
) -> Identification:
    """Judge the URDF and fitted models on the held-out blocks; the last model is the one whose parameters are
    reported.

    Args:
        prepared: the data.
        models: fitted ones by name, "rigid_body" first.
        settings: what the user asked for.
        progress: called with the stage and the part of it that is done.
        suspected: of the recordings.
    """
    suspected = with_late_torque(suspected, prepared)
    coefficients = {"urdf": prepared.prior.reference, **{name: model.x for name, model in models.items()}}
    final = list(models.values())[-1]
    sure = bool(torch.isfinite(final.covariance).all())
    base = base_parameters(prepared.robot)
    covariance = final.inertial_covariance(final.covariance)
    modules = _modules(prepared, models)
    # Moments alone have no rows, and no recordings to fit the baseline to.
    baseline = {"baseline": fit_baseline(prepared)} if prepared.recordings else {}
    compared = {"urdf": modules["urdf"], **baseline, **modules}
    series = torque_series(prepared.reading, compared, prepared.kept_back, progress)
    if len(series.t):
        fits = {name: series.fit(name) for name in compared}
    else:
        fits = {name: judge(prepared.judging, x) for name, x in coefficients.items()}
    regime = regime_of(prepared, settings.estimator)
    simulation = _simulation(prepared, modules, progress)
    loop, loop_facts = _closed_loop(prepared, compared, progress)
    own, mounting = doubts_of(prepared, final, fits), fixed_base(prepared.robot)
    remarks = (
        *own,
        # Torques that the model explains show that the base stood still.
        *(mounting if own else ()),
        *motion_doubts(prepared.reading.simulated),
        *encoder_doubts(prepared, settings),
    )
    doubtful = (*(one for one in suspected.found if one.spoils), *remarks, *([regime] if regime.biases else []))
    return Identification(
        robot=prepared.robot,
        recordings=prepared.fitted,
        held_out=prepared.holdout_words,
        cutoff_hz=prepared.filtering.cutoff_hz,
        fits=fits,
        verdict=verdict_of(fits, doubtful, suspect=suspected.settles or tells_nothing(prepared, final)),
        parameters=(
            *(inertial_estimates(prepared, final) if sure else values_alone(prepared, final, base)),
            *(p if sure else replace(p, std=np.nan, prior_share=np.nan) for p in term_estimates(final)),
        ),
        combinations=base.combinations(),
        base=base_estimates(prepared, final, base),
        base_combination=base.combination.numpy(),
        base_covariance=(base.combination @ covariance @ base.combination.T).numpy() if sure else None,
        covariance=covariance.numpy() if sure else None,
        noise=_noise(prepared, final),
        regime=regime,
        series=series,
        model=_judged(list(modules.values())[-1], series, prepared.filtering, list(fits.values())[-1]),
        posterior=Posterior(prepared.prior, final) if sure else None,
        remarks=remarks,
        facts=(*(() if own else mounting), *prepared.facts, *simulation.notes, *loop_facts),
        suspicions=suspected,
        simulation=simulation.errors,
        closed_loop=loop,
        gains=prepared.reading.gains,
    )


def _modules(prepared: Prepared, models: Mapping[str, FittedModel]) -> dict[str, RigidBodyDynamics]:
    """Return the URDF and fitted models as modules that know how the recordings were made."""
    modules = {name: model.module() for name, model in models.items()}
    width = list(modules.values())[-1].rest_width
    urdf = RigidBodyDynamics(prepared.robot, terms=described_terms(prepared.robot), rest_width=width)
    modules = {"urdf": urdf, **modules}
    for module in modules.values():
        module.conditions, module.drives = prepared.reading.conditions, prepared.reading.drives
    return modules


def _judged(model: RigidBodyDynamics, series: TorqueSeries, filtering: Filtering, fit: Fit) -> RigidBodyDynamics:
    """Return a model that knows which rows were held out, and what was reported of these."""
    spans = held_out_spans(series)
    model.conditions = {name: replace(one, held_out_s=spans.get(name, ())) for name, one in model.conditions.items()}
    model.reported = Reported(filtering.cutoff_hz, dict(fit.nmse), filtering.low_pass)
    return model


def _simulation(prepared: Prepared, modules: Mapping[str, RigidBodyDynamics], progress: Progress) -> MotionErrors:
    """Roll the URDF and fitted models forward on the held-out blocks, where recordings are at hand.

    A torque that was computed for the recorded positions holds no other ones: robots with drives have a closed loop.
    """
    if not prepared.recordings or prepared.reading.has_drives:
        return MotionErrors((), ())
    progress("simulating motion", 0.0)
    return motion_errors(prepared.reading, prepared.statistics.blocks, prepared.held_out.tolist(), modules, progress)


def _closed_loop(
    prepared: Prepared, modules: Mapping[str, RigidBodyDynamics], progress: Progress
) -> tuple[ClosedLoop | None, tuple[Remark, ...]]:
    """Let the drives of all models follow the set-points of the held-out blocks; None without drives."""
    if not prepared.recordings or not prepared.reading.has_drives:
        return None, ()
    return closed_loop(prepared.reading, prepared.statistics.blocks, prepared.held_out.tolist(), modules, progress)


def _noise(prepared: Prepared, model: FittedModel) -> dict[str, JointNoise]:
    noise = prepared.input_noise
    columns = zip(noise.encoder_std, noise.torque_std, model.noise_variance.sqrt(), strict=True)
    return {
        name: JointNoise(*map(float, values))
        for name, values in zip(prepared.robot.joint_names, columns, strict=True)
        if torch.isfinite(values[2])
    }
