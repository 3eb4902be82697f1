"""Residuals without a name: curves without a law, and joints whose held-out torque is predicted badly."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from torchrbd.dataset.columns import Candidate
from torchrbd.diagnosis.curve_hypotheses import depends_on
from torchrbd.diagnosis.curves import fitted_curve, loudest_part
from torchrbd.diagnosis.decisions import DECISIONS
from torchrbd.diagnosis.explain import torque_rms
from torchrbd.diagnosis.final_model import FinalModel
from torchrbd.diagnosis.held_out_checks import EXTENDED
from torchrbd.diagnosis.hypotheses import Hypothesis
from torchrbd.diagnosis.outcome import SearchOutcome
from torchrbd.diagnosis.results import Elpd, HeldOutCheck, Region, Unexplained, Where
from torchrbd.diagnosis.state_dependence import state_dependence
from torchrbd.effects.smooth_torque import HUM
from torchrbd.inference.results import TorqueSeries
from torchrbd.nuisance.drift import DRIFT_HZ, MOST_DRIFT, drift_basis
from torchrbd.robot import RobotModel
from torchrbd.robot.units import torque_unit

# Kinds of entries that are about the held-out error of a joint.
_ERRORS = ("error", "larger error")


def unexplained(extended: FinalModel, curves: Mapping[Candidate, Elpd]) -> tuple[Unexplained, ...]:
    """Return torques that no known effect explains: smooth functions that predict left-out blocks, and tones.

    Args:
        extended: the model.
        curves: what its smooth functions are worth.
    """
    counted = [(term, elpd.share) for term, elpd in curves.items() if elpd.share >= DECISIONS.no_change]
    return (*(_curve(extended, term, share) for term, share in counted), *_tones(extended.found))


def merge_errors(found: Sequence[Unexplained]) -> tuple[Unexplained, ...]:
    """Return the same with the held-out error of a joint in the first other entry of that joint, if there is one.

    Of itself the error says how large it is, and that nothing explains it.
    """
    errors = {one.joints: one for one in found if one.kind in _ERRORS}
    others = {one.joints: one for one in reversed(found) if one.kind not in _ERRORS}
    kept = []
    for one in found:
        if one is others.get(one.joints) and one.joints in errors:
            kept.append(replace(one, sizes={**one.sizes, **errors[one.joints].sizes}))
        elif one.kind not in _ERRORS or one.joints not in others:
            kept.append(one)
    return tuple(kept)


def _tones(found: SearchOutcome) -> list[Unexplained]:
    """Return tones of the fitted recordings, of which held-out recordings say nothing."""
    return [_tone(found, term.own) for term in found.terms if term.own.candidate.effect is HUM]


def drifts(series: TorqueSeries, robot: RobotModel) -> Iterator[Unexplained]:
    """Yield joints where the residual of the extended model, on fitted data, wanders by more than the rest of it.

    The part that wanders is the projection on the lowest frequencies of each recording, without their levels.
    """
    residual = series.residual(EXTENDED)
    for j, name in enumerate(series.joints):
        rows = ~series.held_out & np.isfinite(residual[:, j])
        if not rows.any():
            continue
        left = residual[rows, j]
        basis, order = drift_basis(series.t[rows], series.recording[rows], DRIFT_HZ, MOST_DRIFT)
        w = np.linalg.lstsq(basis.T, left, rcond=None)[0]
        drift, noise = (float(np.sqrt(np.mean(x**2))) for x in (w[order > 0] @ basis[order > 0], left - w @ basis))
        torque = float(np.sqrt(np.mean(series.measured[rows, j] ** 2)))
        if math.hypot(drift, noise) > DECISIONS.larger_error * noise and drift > DECISIONS.negligible_torque * torque:
            share, sizes, unit = drift**2 / (drift**2 + noise**2), {"torque_rms": drift}, torque_unit(robot, j)
            yield Unexplained((name,), ("t",), Where(), share, kind="drift", sizes=sizes, unit=unit)


def _tone(found: SearchOutcome, h: Hypothesis) -> Unexplained:
    """Describe torque of one frequency, whatever the motion, as the wide band shows it."""
    rows, joint, names, f = found.rows, h.candidate.joint, h.candidate.site.recordings, h.candidate.shape["frequency"]
    assert names is not None
    robot, inside = rows.columns.robot, np.isin(rows.recording, [rows.recordings.index(name) for name in names])
    width = 1.0 / max(float(np.ptp(rows.t[inside])), 1e-9)
    amplitudes = np.hypot(h.coefficients[::2], h.coefficients[1::2])
    left = found.base.residual(joint)[inside]
    share = min(1.0, 0.5 * float(np.mean(amplitudes**2)) / max(float(np.mean(left**2)), 1e-300))
    region = (Region("frequency", f - width, f + width),)
    everywhere = len(names) == len(rows.seen_recordings)
    where = Where(None if everywhere else names, None, region)
    sizes = {"low": float(amplitudes.min()), "high": float(amplitudes.max()), "frequency": float(f)}
    unit = torque_unit(robot, joint)
    return Unexplained((robot.joint_names[joint],), ("t",), where, share, kind="tone", sizes=sizes, unit=unit)


def _curve(extended: FinalModel, term: Candidate, share: float) -> Unexplained:
    model = extended.model
    robot, joint = model.columns.robot, term.joint
    name, unit = robot.joint_names[joint], torque_unit(robot, joint)
    signals, region, curve = depends_on(term, robot.joint_names), None, fitted_curve(model, term)
    carried = torque_rms(term, extended).get(name, 0.0)
    recording = None if term.site.window is None else term.site.window.recording
    if curve is not None and signals[0] != "t":
        region = Region(signals[0], *loudest_part(np.array(curve.at), np.array(curve.torque)))
    where = Where(None if recording is None else (recording,), None, None if region is None else (region,))
    return Unexplained((name,), signals, where, share, curve, sizes={"torque_rms": carried}, unit=unit)


def large_errors(
    series: TorqueSeries, held_out_checks: Sequence[HeldOutCheck], reported: Collection[str]
) -> Iterator[Unexplained]:
    """Yield joints whose held-out torque is predicted badly by the extended model, by errors that have a memory.

    "Badly" is a large NMSE of errors that depend on the states, or are clearly larger than those of the fit. Joints at
    which nothing is ``reported`` need not have a large one. White errors are noise, of which some motions make more
    than others; those that no function of the states predicts are noise, too. Drift has its own entries.
    """
    lasting = {p.joint for p in held_out_checks if p.memory_s[EXTENDED] > DECISIONS.memory * p.white_s}
    if not lasting:
        return
    nmse, (seen, unseen) = series.fit(EXTENDED).nmse, _errors_without_drift(series)
    for j, name in enumerate(series.joints):
        if name not in lasting:
            continue
        poor = nmse[name] > DECISIONS.poor_nmse
        if poor and (elpd := state_dependence(series, j, EXTENDED)).certain and elpd.share >= DECISIONS.no_change:
            sizes = {"nmse": nmse[name], "states": elpd.share}
            yield Unexplained((name,), (), Where(), elpd.share, kind="error", sizes=sizes)
        elif (poor or name not in reported) and unseen[j] > DECISIONS.larger_error * seen[j] > 0.0:
            share, sizes = 1.0 - (seen[j] / unseen[j]) ** 2, {"ratio": float(unseen[j] / seen[j])}
            yield Unexplained((name,), (), Where(), share, kind="larger error", sizes=sizes)


def _errors_without_drift(series: TorqueSeries) -> list[np.ndarray]:
    """Return the errors (n,) of fitted and of held-out data, RMS, without what wanders in time."""
    residual, found = series.residual(EXTENDED), np.full((2, len(series.joints)), np.nan)
    for j in range(len(series.joints)):
        for k, own in enumerate((~series.held_out, series.held_out)):
            rows = own & np.isfinite(residual[:, j])
            if rows.any():
                left = residual[rows, j]
                basis, _ = drift_basis(series.t[rows], series.recording[rows], DRIFT_HZ, MOST_DRIFT)
                left = left - np.linalg.lstsq(basis.T, left, rcond=None)[0] @ basis
                found[k, j] = np.sqrt(np.mean(left**2))
    return [*found]
