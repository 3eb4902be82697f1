"""What the model has no name for: smooth terms, and what was located in the leftover of all terms."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from torchrbd.diagnosis.curves import fitted_curve
from torchrbd.diagnosis.locate.hum import described
from torchrbd.diagnosis.results import Curve, Location, Region, Unexplained, Where
from torchrbd.diagnosis.rows.regression import Fit
from torchrbd.diagnosis.search.terms import without
from torchrbd.diagnosis.search.unnamed import depends_on, is_smooth
from torchrbd.diagnosis.words import joined, number, percent, torque_unit
from torchrbd.inference.physical.fitting import FittedModel
from torchrbd.likelihood.columns import Candidate
from torchrbd.physics.smooth_torque import HUM

# A function acts where it is above this part of its largest departure from its middle.
_ACTS = 0.5


def nameless(fit: Fit, model: FittedModel, left: Sequence[Location]) -> tuple[Unexplained, ...]:
    """Return what is unexplained.

    Args:
        fit: of the search.
        model: the fit with the same terms, in the same order.
        left: what was located in the leftover of the model.
    """
    pairs = zip(fit.terms, model.proper_terms, strict=False)
    found = [_described(fit, searched, model, term) for searched, term in pairs if is_smooth(term)]
    known = {(x.joints, x.depends_on[:1]) for x in found}
    # A function of time in the model is not what is left beside it.
    rest = [x for x in left if x.form in ("hum", "wander", "shock") or (x.joints, x.depends_on[:1]) not in known]
    return (*found, *(_from_location(x) for x in rest))


def _from_location(x: Location) -> Unexplained:
    return Unexplained(x.joints, x.depends_on, x.where, max(x.share.values()), x.statement, x.curve)


def _described(fit: Fit, searched: Candidate, model: FittedModel, term: Candidate) -> Unexplained:
    robot, joint = model.columns.robot, term.joint
    rest = Fit(fit.rows, without(fit.terms, searched))
    share = max(0.0, 1.0 - float(fit.errors[:, joint].sum() / max(rest.errors[:, joint].sum(), 1e-300)))
    name, unit = robot.joint_names[joint], torque_unit(robot, joint)
    if term.effect is HUM:
        region, statement = _hum(fit, model, term)
        return _unexplained(term, name, ("t",), region, share, statement)
    signals, region = depends_on(term, robot.joint_names), None
    curve = fitted_curve(model, term)
    if curve is not None and signals[0] != "t":
        region = Region(signals[0], *_loud(np.array(curve.at), np.array(curve.torque)))
    statement = (
        f"{name}: no known effect explains {percent(share)} of the power of what is left. "
        f"It depends on {joined(signals)}"
    )
    if curve is not None:
        least, most = min(curve.torque), max(curve.torque)
        statement += f", as a torque from {number(least)} to {number(most)} {unit}"
    if region:
        statement += f", most of it where {signals[0]} is between {number(region.low)} and {number(region.high)}"
    return _unexplained(term, name, signals, region, share, statement + ".", curve)


def _unexplained(
    term: Candidate,
    joint: str,
    signals: tuple[str, ...],
    region: Region | None,
    share: float,
    statement: str,
    curve: Curve | None = None,
) -> Unexplained:
    recordings = None if term.site.window is None else (term.site.window.recording,)
    where = Where(recordings, None, None if region is None else (region,))
    return Unexplained((joint,), signals, where, share, statement, curve)


def _hum(fit: Fit, model: FittedModel, term: Candidate) -> tuple[Region, str]:
    """Return the band of a hum, and the hum in words, with its recording where there are several."""
    samples, window = fit.rows.samples, term.site.window
    assert window is not None
    lasts = float(np.ptp(samples.t[samples.recording == samples.recordings.index(window.recording)]))
    where = f" in {window.recording}" if len(samples.recordings) > 1 else ""
    amplitude = float(model.coefficients(term)[0].norm())
    return described(model.columns.robot, term.joint, term.shape["frequency"], amplitude, 1.0 / lasts, where)


def _loud(at: np.ndarray, torque: np.ndarray) -> tuple[float, float]:
    """Return the interval around the largest departure from the median in which it stays above half of that."""
    size = np.abs(torque - np.median(torque))
    low = high = int(size.argmax())
    while low > 0 and size[low - 1] > _ACTS * size.max():
        low -= 1
    while high < len(size) - 1 and size[high + 1] > _ACTS * size.max():
        high += 1
    return float(at[low]), float(at[high])
