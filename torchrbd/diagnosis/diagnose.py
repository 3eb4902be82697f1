"""Diagnose: fit the rigid body, find what it leaves out, extend the model, and say what remains."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from torchrbd.diagnosis.compare import Comparison
from torchrbd.diagnosis.explain import explain
from torchrbd.diagnosis.leftover import unexplained
from torchrbd.diagnosis.locate import locate, nameless
from torchrbd.diagnosis.results import Diagnosis, Finding, Unexplained
from torchrbd.diagnosis.select import LEAST_GAIN, LEAST_T, Terms, distinguishable, select_terms
from torchrbd.diagnosis.words import verdict_statement
from torchrbd.errors import OptionError
from torchrbd.inference.data.reading import Progress
from torchrbd.inference.identify import Source, read_arguments, summarise
from torchrbd.inference.preparation import Prepared, prepare
from torchrbd.inference.settings import WITH_INTERVALS
from torchrbd.robot import RobotModel


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
    prepared = prepare(robot, sources, settings, settings.chosen_effects(), progress)
    training, prior = prepared.training, prepared.prior
    comparison = Comparison(training, prior)
    measured = prepared.statistics.torque[..., 0].sum(0) > 0
    progress("searching for missing physics", 0.0)
    candidates = distinguishable(
        comparison, [c for c in prepared.columns.candidates if c.place is not None and measured[c.joint]]
    )

    def tell(found: Terms) -> None:
        last = f": {found[-1].effect.words} at {robot.joint_names[found[-1].joint]}" if found else ""
        progress(f"searching for missing physics, {len(found)} found{last}", 0.0)

    terms = select_terms(comparison, candidates, tell)
    progress("fitting", 0.0)
    models = {"rigid_body": prepared.fit(), "extended": prepared.fit(terms)}
    identification = summarise(prepared, models, settings, progress)
    progress("weighing the findings", 0.0)
    findings = explain(prepared, comparison, terms, candidates, models["extended"])
    progress("looking at what is left", 0.0)
    locations, maps = locate(prepared, models["rigid_body"].pi)
    left = locations
    if terms:
        left, more = locate(prepared, models["extended"].pi, terms, "extended")
        locations, maps = (*locations, *left), (*maps, *more)
    units = ["N" if prismatic else "N m" for prismatic in robot.prismatic.tolist()]
    rest = unexplained(identification.series, "extended", prepared.filtering.effective_rate, units)
    rest = nameless(left, rest)
    verdict = _verdict(findings, rest, _refit_matters(prepared, comparison))
    statement = verdict_statement(verdict, findings, rest, identification.fits)
    return Diagnosis(identification, verdict, statement, findings, rest, locations, maps)


def _refit_matters(prepared: Prepared, comparison: Comparison) -> bool:
    """Say whether re-fitted inertial parameters predict unseen blocks better than the URDF's."""
    comparison.set_noise(())
    better = comparison.gain(comparison.errors((), rigid=False), comparison.errors(()))
    return better.total > LEAST_GAIN and better.t > LEAST_T


def _verdict(findings: Sequence[Finding], rest: Sequence[Unexplained], refit_matters: bool) -> str:
    if findings:
        return "missing_physics"
    if rest:
        return "unexplained"
    return "parameters" if refit_matters else "consistent"
