"""Search: the physics that the likelihood asks for, and what else was considered, before anything is named."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch

from torchrbd._runtime.deadline import time_limited
from torchrbd._runtime.threads import single_threaded
from torchrbd.dataset.band import band_hz
from torchrbd.dataset.reading import Progress, Reading
from torchrbd.dataset.rows import KeptBack, not_held_out
from torchrbd.diagnosis.evidence import ModelEvidence
from torchrbd.diagnosis.hypotheses import Hypothesis, hypothesis_of, whole
from torchrbd.diagnosis.outcome import SearchOutcome
from torchrbd.diagnosis.ranked import Ranked, Ranking
from torchrbd.diagnosis.screening import is_clocks
from torchrbd.diagnosis.search import search_effects
from torchrbd.effects import Effect, Site, Window
from torchrbd.effects.registry import effect
from torchrbd.errors import RecordingError
from torchrbd.inference.identify import read_arguments
from torchrbd.inference.preparation import read
from torchrbd.inference.settings import Settings
from torchrbd.likelihood.clocks import Clocks, in_band
from torchrbd.likelihood.likelihood import Likelihood
from torchrbd.likelihood.misfit import Misfit
from torchrbd.likelihood.misspecification import MISFIT, TwoEstimates
from torchrbd.nuisance.joint_friction import FRICTION_EFFECTS
from torchrbd.options import Names, Payload, given
from torchrbd.recordings import Sources
from torchrbd.robot import RobotModel

# Hypotheses that are shown.
_SHOWN = 30


@dataclass(frozen=True)
class SearchResult:
    """A search, and the same as a result.

    Attributes:
        ranking: all that was considered.
        clocks: the model that estimates the delays.
        explanation: what was found.
    """

    ranking: Ranking
    clocks: Clocks
    explanation: SearchOutcome


@time_limited
@single_threaded()
def rank_hypotheses(
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
) -> Ranking:
    """Rank the effects that a URDF may leave out by their log evidence, without naming any.

    Args:
        robot: a robot or its URDF.
        recordings: files, opened recordings or data in memory, as for ``identify``; those held out are not looked at.
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
    """
    robot, sources, settings = read_arguments(robot, recordings, given(locals()), "rank_hypotheses")
    reading, _ = read(robot, sources, settings, progress)
    held = {recording.name for recording in reading.recordings[len(sources) :]}

    def kept_back(name: str, t: torch.Tensor) -> torch.Tensor:
        return torch.full((len(t),), name in held)

    return run_search(reading, settings, kept_back, progress).ranking


def run_search(reading: Reading, settings: Settings, kept_back: KeptBack, progress: Progress) -> SearchResult:
    """Search among effects on recordings that have been opened.

    Args:
        reading: how they are read; its cut-off does not matter unless the settings name one.
        settings: the user's choices.
        kept_back: what of them is held out.
        progress: called with the stage and the part of it that is done.
    """
    robot, effects = reading.robot, settings.chosen_effects()
    surveys = [reading.surveys[k] for k in not_held_out(reading, kept_back)]
    band = settings.cutoff_hz or band_hz(surveys, reading.filtering.low_pass)

    def report(part: float, terms: int) -> None:
        progress(f"searching, effects so far: {terms}", part)

    try:
        clocks = in_band(reading, band, kept_back, frozenset(settings.held_bodies(robot)), progress)
        fit = clocks.fit
        progress("learning the noise and residual curves", 0.0)
        found = search_effects(fit, effects, report)
    except np.linalg.LinAlgError as error:
        names = ", ".join(r.name for r in reading.recordings)
        raise RecordingError(
            f"{names}: below {band:.3g} Hz the torques and motions have no regression ({error}); look for constant or "
            "repeated channels, or choose another cut-off"
        ) from error
    return _result(found, band, replace(clocks, fit=found.fit), effects)


def _result(found: SearchOutcome, band: float, clocks: Clocks, effects: Sequence[Effect]) -> SearchResult:
    fit, robot = found.base, found.rows.columns.robot
    late = _of_all(clocks, effects)

    def shown(hypotheses: Sequence[Hypothesis], given: Likelihood) -> tuple[Ranked, ...]:
        every = [*(_ranked(h, given, robot) for h in hypotheses[:_SHOWN]), *late]
        return tuple(sorted(every, key=lambda h: -h.log_evidence)[:_SHOWN])

    two = TwoEstimates(fit)
    seen = [j for j in range(robot.n_dof) if fit.machine.rows.seen[j]]
    misfit = {robot.joint_names[j]: two.test(fit.machine.friction.at(j)) for j in seen}
    own = [term.own for term in found.terms]
    first = shown(found.first, fit)
    ranking = Ranking(
        band_hz=band,
        ordinary=_ordinary(fit, two, misfit),
        delay_s=clocks.delay_s,
        first=first,
        adopted=tuple(_ranked(h, found.fit, robot) for h in own),
        last=shown([*own, *found.last], found.fit),
        considered=found.considered + len(late),
        misfit=misfit,
        evidence_source=partial(_evidence_of, found, effects, first),
    )
    return SearchResult(ranking, clocks, found)


def _evidence_of(
    found: SearchOutcome,
    effects: Sequence[Effect],
    first: Sequence[Ranked],
    effect_id: str,
    joints: Sequence[str],
    links: Sequence[str],
    shape: dict[str, Any],
    window: tuple[str, float, float] | None,
) -> float:
    """Return the log evidence of one given hypothesis, see ``Ranking.evidence_of``."""
    robot = found.rows.columns.robot
    other = shape.pop("other", None)
    everywhere = len(joints) == robot.n_dof > 1
    site = Site(
        joint=robot.joint_names.index(joints[0]) if joints and not everywhere else None,
        other=None if other is None else robot.joint_names.index(other),
        body=robot.body_names.index(links[0]) if links else None,
        window=None if window is None else Window(*window),
    )
    e = effect(effect_id)
    if is_clocks(e, site, found.rows):
        return next((h.log_evidence for h in first if (h.effect, h.joints) == (e.id, ())), 0.0)
    candidate = found.rows.columns.candidate(e, site, shape)
    one = hypothesis_of(found.base, found.rows, candidate)
    if one is None:
        return -math.inf
    (one,) = ModelEvidence(found.rows, effects, found.discrepancy).evidence([], one)
    return one.log_evidence


def _of_all(clocks: Clocks, effects: Sequence[Effect]) -> list[Ranked]:
    """Return what an offset of the clocks, of all recordings alike, may be: a delay, or actuators that lag.

    A command runs ahead of what it makes, so that it is recorded early.
    """
    if not clocks.delay_s:
        return []
    late, std = np.array(list(clocks.delay_s.values())).T
    mean = float(np.average(late, weights=std**-2.0))
    found = ((e, e.of_clock_offset(mean)) for e in effects)
    return [
        Ranked(e.id, (), (), clocks.against + (clocks.lag_odds if e.lags else 0.0), values)
        for e, values in found
        if values is not None
    ]


def _ranked(h: Hypothesis, fit: Likelihood, robot: RobotModel) -> Ranked:
    c, site = h.candidate, h.candidate.site
    w = torch.from_numpy(whole(c, h.coefficients, fit.friction))
    window = None
    if site.window is not None:
        rows = fit.machine.rows
        t = rows.t[rows.recording == rows.recordings.index(site.window.recording)]
        begin, end = max(site.window.start_s, float(t[0])), min(site.window.end_s, float(t[-1]))
        window = site.window.recording, begin, end
    return Ranked(
        effect=c.effect.id,
        joints=() if site.joint is None else (robot.joint_names[site.joint],),
        links=() if site.body is None else (robot.body_names[site.body],),
        log_evidence=h.log_evidence,
        parameters={k: float(v) for k, v in c.effect.parameters(w, c.shape).items() if k not in c.effect.follows},
        other=None if site.other is None else robot.joint_names[site.other],
        window=window,
        shape=dict(c.shape),
    )


def _ordinary(fit: Likelihood, two: TwoEstimates, misfit: Mapping[str, Misfit]) -> tuple[Ranked, ...]:
    """Return the friction that every joint has, and the evidence against leaving it out."""
    robot, found = fit.machine.rows.columns.robot, []
    predicting = np.maximum(fit.machine.friction.of(two.ordinary, fit.hyper), 0.0)
    for j, name in enumerate(robot.joint_names):
        if not fit.machine.rows.seen[j]:
            continue
        at = fit.machine.friction.at(j)
        viscous, plus, minus = map(float, (predicting if misfit[name].p_value < MISFIT else fit.friction)[j])
        for identifier, index, values in (
            (FRICTION_EFFECTS[0], at[:1], {"viscous": viscous}),
            (FRICTION_EFFECTS[1], at[1:], {"coulomb_plus": plus, "coulomb_minus": minus}),
        ):
            width = {"width": float(fit.hyper.rest_width[j])} if len(index) > 1 else {}
            evidence = fit.gaussian.against(index)
            found.append(Ranked(identifier, (name,), (), evidence, values, shape=width))
    return tuple(found)
