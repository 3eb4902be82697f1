"""Identify a robot: prepare, fit, judge, and collect what a person or a report wants to know."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchrbd.inference.data.reading import Progress
from torchrbd.inference.estimators import estimate
from torchrbd.inference.physical.fitting import FittedModel, judge, predict, term_candidates
from torchrbd.inference.physical.prior import local_covariance
from torchrbd.inference.physical.terms import term_estimates
from torchrbd.inference.posterior.identifiability import identifiability
from torchrbd.inference.posterior.posterior import Posterior
from torchrbd.inference.preparation import Prepared, prepare
from torchrbd.inference.results import (
    BaseParameterEstimate,
    Fit,
    Identification,
    JointNoise,
    ParameterEstimate,
    TorqueSeries,
)
from torchrbd.inference.settings import Settings
from torchrbd.parameters import PARAMETERS_PER_BODY, UNITS, BaseParameters, base_parameters
from torchrbd.recordings import Recording
from torchrbd.robot import RobotModel

# Estimators that come with intervals of their own; see preparation.py for the choice between them.
_OWN = ("auto", "physical", "smoother")
_POOR, _ABSURD, _WORSE, _IMPLAUSIBLE = 0.8, 100.0, 1.2, 5.0


def identify(
    robot: RobotModel | str | Path | bytes,
    recordings: Sequence[str | Path | Recording] | str | Path | Recording,
    *,
    progress: Progress = lambda *_: None,
    **options: Any,
) -> Identification:
    """Fit a robot's inertial parameters to recordings; the result is always physically valid.

    Args:
        robot: a robot or its URDF.
        recordings: files or opened recordings.
        progress: told how far the work is.
        **options: see ``Settings``. ``effects`` are fitted beside the inertial parameters, at every joint.

    Raises:
        InputError: a robot, recording or option that cannot be used.
    """
    robot = robot if isinstance(robot, RobotModel) else RobotModel.from_urdf(robot)
    settings = Settings.from_mapping(options, "identify")
    effects = settings.chosen_effects() if settings.effects else ()
    prepared = prepare(robot, listed(recordings), settings, effects, progress)
    progress("fitting", 0.0)
    models = {"rigid_body": prepared.fit()}
    if effects:
        terms = term_candidates(prepared.columns, [e.id for e in effects])
        models["extended"] = prepared.fit(terms)
    if settings.estimator not in _OWN:
        for name, model in models.items():
            found = estimate(prepared, settings.estimator, model.terms)
            models[name] = replace(model, x=found.x)
        made = "" if found.was_physical else ", made physical"
        note = f"parameters are those of '{settings.estimator}'{made}; intervals are those of the default fit"
        prepared = replace(prepared, notes=(*prepared.notes, note, *filter(None, [found.note])))
    return summarise(prepared, models, progress)


def listed(recordings: Sequence[str | Path | Recording] | str | Path | Recording) -> list[str | Path | Recording]:
    """Return one or several recordings as a list."""
    return [recordings] if isinstance(recordings, (str, Path, Recording)) else list(recordings)


def summarise(prepared: Prepared, models: dict[str, FittedModel], progress: Progress) -> Identification:
    """Judge the URDF and fitted models on the blocks kept back; the last model is the one whose parameters are
    reported.

    Args:
        prepared: the data.
        models: fitted ones by name, "rigid_body" first.
        progress: told how far the work is.
    """
    coefficients = {"urdf": prepared.prior.reference, **{name: model.x for name, model in models.items()}}
    final = list(models.values())[-1]
    base = base_parameters(prepared.robot)
    fits = {name: judge(prepared.judging, x) for name, x in coefficients.items()}
    return Identification(
        robot=prepared.robot,
        recordings=prepared.fitted,
        held_out=prepared.holdout_words,
        cutoff_hz=prepared.filtering.cutoff_hz,
        fits=fits,
        parameters=(
            *_inertial_estimates(prepared, final),
            *term_estimates(final),
        ),
        combinations=base.sentences(),
        base=_base_estimates(prepared, final, base),
        covariance=final.inertial_covariance(final.covariance).numpy(),
        noise=_noise(prepared, final),
        states="filtered" if prepared.states is None else "smoothed",
        regime=_regime(prepared),
        series=torque_series(prepared, coefficients, progress),
        model=final.module(),
        posterior=Posterior(prepared.prior, final),
        notes=(*prepared.notes, *_doubts(prepared, final, fits)),
    )


def _doubts(prepared: Prepared, model: FittedModel, fits: dict[str, Fit]) -> list[str]:
    """Return what looks like wrong input, and where the fitted model does worse than what it was to better."""
    fitted, told = judge(prepared.training, model.x).nmse, judge(prepared.training, prepared.prior.reference).nmse
    last = fits[list(fits)[-1]].nmse
    doubts = []
    for joint, nmse in fitted.items():
        if nmse > _POOR:
            doubts.append(
                f"the fitted model explains little of the torque of {joint} (nmse {nmse:.2f} where it was fitted): "
                "check the unit, sign, gear ratio and name of its columns, or let diagnose look for missing friction"
            )
        if told[joint] > _ABSURD:
            doubts.append(
                f"the URDF's torque for {joint} is more than ten times off: check the units (rad, s, N m) of the "
                "recording and of the URDF before trusting any finding"
            )
        if joint in last and last[joint] > _WORSE * fits["urdf"].nmse[joint]:
            doubts.append(
                f"on held-out data {joint} is predicted worse than by the URDF as given "
                f"(nmse {last[joint]:.3g} against {fits['urdf'].nmse[joint]:.3g})"
            )
    for body in prepared.prior.bodies:
        urdf, found = (float(x[PARAMETERS_PER_BODY * body]) for x in (prepared.prior.reference, model.x))
        if not 1 / _IMPLAUSIBLE < found / urdf < _IMPLAUSIBLE:
            doubts.append(
                f"the mass of {prepared.robot.body_names[body]} comes out {found / urdf:.2g} times the URDF's: a load, "
                "something that the model lacks (try diagnose), or a motion that tells it too little"
            )
    if not model.converged:
        doubts.append("the fit stopped early: the torques are far from those of any rigid body; check units and signs")
    return doubts


def _noise(prepared: Prepared, model: FittedModel) -> dict[str, JointNoise]:
    noise = prepared.input_noise
    columns = zip(noise.encoder_std, noise.torque_std, model.noise_variance.sqrt(), strict=True)
    return {
        name: JointNoise(*map(float, values))
        for name, values in zip(prepared.robot.joint_names, columns, strict=True)
        if torch.isfinite(values[2])
    }


def _regime(prepared: Prepared) -> str:
    """Say in a sentence what position noise does here, and what was done about it."""
    excess = prepared.input_noise.excess
    if prepared.input_noise.matters:
        size = "more than 100" if excess > 100 else f"{excess:.2g}"
        effect = (
            f"position noise matters: fitted to filtered states, parameters would have {size} times the squared error"
        )
    else:
        share = "less than 1" if excess < 1.01 else f"{100 * (excess - 1):.0f}"
        effect = f"position noise hardly matters: it adds {share} % to the parameters' squared error"
    return effect + (
        "; states are filtered" if prepared.states is None else "; states and parameters are smoothed together"
    )


def _base_estimates(prepared: Prepared, model: FittedModel, base: BaseParameters) -> tuple[BaseParameterEstimate, ...]:
    """Return beta = K pi with the covariance K cov(pi) K'."""
    K, n = base.combination, prepared.robot.n_params
    variance, laplace = ((K @ model.inertial_covariance(c) @ K.T).diagonal() for c in (model.covariance, model.laplace))
    fitted = K[:, prepared.prior.inertial]
    believed = (fitted @ local_covariance(prepared.prior, model.x) @ fitted.T).diagonal()
    share = torch.where(believed > 0, (laplace / believed.clamp_min(1e-300)).clamp(0.0, 1.0), torch.ones_like(believed))
    urdf, value = K @ prepared.prior.reference[:n], K @ model.pi
    rows = zip(base.independent, base.expressions, urdf, value, variance.sqrt(), share, strict=True)
    return tuple(
        BaseParameterEstimate(expression, UNITS[k % PARAMETERS_PER_BODY], *map(float, numbers))
        for k, expression, *numbers in rows
    )


def torque_series(prepared: Prepared, coefficients: dict[str, Tensor], progress: Progress) -> TorqueSeries:
    """Stream the recordings once more and predict every torque with every model."""
    parts: dict[str, list[np.ndarray]] = {
        key: [] for key in ("recording", "t", "held_out", "q", "qd", "qdd", "measured")
    }
    predicted: dict[str, list[np.ndarray]] = {name: [] for name in coefficients}
    for k, recording in enumerate(prepared.recordings):
        progress("predicting torques", k / len(prepared.recordings))
        for states in prepared.tiles(k):
            measured = states.decimate(torch.nan_to_num(states.tau)).T
            measured[:, ~prepared.measured(k)] = torch.nan
            parts["recording"].append(np.full(len(states.t_out), k))
            parts["t"].append(states.t_out.numpy())
            parts["held_out"].append(prepared.kept_back(recording.name, states.t_out).numpy())
            parts["measured"].append(measured.numpy())
            for key, signal in (("q", states.q), ("qd", states.qd), ("qdd", states.qdd)):
                parts[key].append(states.decimate(signal).T.numpy())
            for name, x in coefficients.items():
                predicted[name].append(states.decimate(predict(prepared.columns, x, states)).T.numpy())
    joined = {key: np.concatenate(values) for key, values in parts.items()}
    return TorqueSeries(
        joints=tuple(prepared.robot.joint_names),
        recordings=tuple(r.name for r in prepared.recordings),
        predicted={name: np.concatenate(values) for name, values in predicted.items()},
        **joined,
    )


def _inertial_estimates(prepared: Prepared, model: FittedModel) -> list[ParameterEstimate]:
    std = model.inertial_covariance(model.covariance).diagonal().sqrt()
    known = identifiability(prepared.prior, model, prepared.filtering.effective_rate)
    return [
        ParameterEstimate(
            name=one.name,
            owner=one.owner,
            unit=UNITS[k % PARAMETERS_PER_BODY],
            urdf=float(prepared.prior.reference[k]),
            value=float(model.x[k]),
            std=float(std[k]),
            prior_share=one.prior_share,
            status=one.status,
            suggestion=one.suggestion,
        )
        for k, one in enumerate(known)
    ]
