"""Torque without a law, as hypotheses: smooth functions of what a joint's residual may depend on, and tones.

A tone is where the periodogram of the residual exceeds its neighbourhood most. Its evidence pays for the free choice of
the frequency.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace

import numpy as np
from scipy.linalg import null_space
from scipy.ndimage import median_filter
from scipy.optimize import OptimizeResult, minimize_scalar
from scipy.signal import detrend, periodogram

from torchrbd.dataset.columns import Candidate
from torchrbd.dataset.rows import Rows
from torchrbd.diagnosis.hypotheses import Hypothesis, average_over_shapes
from torchrbd.effects import Site, Window
from torchrbd.effects.smooth_torque import HUM, SMOOTH, SmoothTorque
from torchrbd.likelihood.likelihood import Likelihood

# Beyond these quantiles of a signal there are too few rows to estimate a function.
_ENDS = (0.01, 0.99)
# Slower than this it is drift, or the motion; width of the neighbourhood that a tone is compared with [Hz].
_SLOWEST_HZ, _AROUND_HZ = 1.0, 1.5


def curves(fit: Likelihood, rows: Rows) -> list[Hypothesis]:
    """Return functions of each signal, and a tone, at every joint that has a torque, given a fit."""
    return [*curves_at(fit, rows, range(rows.n_dof)), *tones(fit, rows)]


def curves_at(fit: Likelihood, rows: Rows, joints: Collection[int]) -> list[Hypothesis]:
    """Return functions of each signal at some joints, given a fit."""
    found = (average_over_shapes(fit, rows, [c]) for c in _candidates(rows) if c.site.joint in joints)
    return [h for h in found if h is not None]


def tones(fit: Likelihood, rows: Rows) -> list[Hypothesis]:
    """Return the tone that stands out most, of all joints and recordings, in its recording and in all of them.

    Noise is learnt of all: one tone in each is a colour of it as long as another is left.
    """
    found = []
    for j in np.flatnonzero(rows.seen).tolist():
        left = fit.residual(j)
        for name in rows.seen_recordings:
            inside = rows.recording == rows.recordings.index(name)
            run = np.argmax(np.bincount(rows.run[inside]))
            f, power = periodogram(detrend(left[inside & (rows.run == run)]), 1.0 / rows.dt_out, "hann")
            around = median_filter(power, max(3, round(_AROUND_HZ / f[1]))) if len(f) > 1 else power
            ratio = np.where(f > _SLOWEST_HZ, power / np.maximum(around, 1e-300), 0.0)
            if ratio.any():
                tried = math.log(max(int((f > _SLOWEST_HZ).sum()), 1))
                found.append((float(ratio.max()), j, name, float(f[ratio.argmax()]), float(f[1]), tried))
    if not found:
        return []
    _, j, name, near, reach, tried = max(found)
    inside = rows.recording == rows.recordings.index(name)
    shape = {"frequency": _peak(fit.residual(j)[inside], rows.t[inside], near, reach)}
    places = (Site(j, recordings=recordings) for recordings in dict.fromkeys(((name,), tuple(rows.seen_recordings))))
    each = (average_over_shapes(fit, rows, [rows.columns.candidate(HUM, site, shape)]) for site in places)
    return [replace(h, log_evidence=h.log_evidence - tried, paid=h.paid - tried) for h in each if h is not None]


def _peak(x: np.ndarray, t: np.ndarray, near: float, reach: float) -> float:
    """Return the frequency [Hz] within reach of one at which a signal (M,) at times (M,) has most power."""

    def amplitude(f: float) -> float:
        return float(abs(x @ np.exp(-2j * np.pi * f * t)))

    step = 0.25 / max(float(np.ptp(t)), 1e-9)
    best = max(np.arange(near - reach, near + reach, step).tolist(), key=amplitude)
    found = minimize_scalar(lambda f: -amplitude(f), bounds=(best - step, best + step), method="bounded")
    assert isinstance(found, OptimizeResult)
    return float(found["x"])


def is_curve(candidate: Candidate) -> bool:
    """Say whether a term is a function without a law."""
    return isinstance(candidate.effect, SmoothTorque)


def is_over_own_signal(candidate: Candidate) -> bool:
    """Say whether a curve is one over a joint's own state, or over time."""
    effect = candidate.effect
    own = isinstance(effect, SmoothTorque) and effect is not HUM and not effect.times_own
    return own and candidate.site.other is None


def is_of_time(candidate: Candidate) -> bool:
    """Say whether a term is a curve over time; a tone is none."""
    effect = candidate.effect
    return isinstance(effect, SmoothTorque) and effect is not HUM and effect.signal == "t"


def curvature_directions(curve: Hypothesis) -> np.ndarray:
    """Return directions (K - 1, K) of a curve's coefficients, all but that in which it is a straight line."""
    line = np.linspace(-1.0, 1.0, len(curve.coefficients))
    return null_space(line[None]).T


def could_absorb_baseline(candidate: Candidate) -> bool:
    """Say whether a term is a curve over a signal in which friction or inertia is linear: it could absorb these."""
    effect = candidate.effect
    return isinstance(effect, SmoothTorque) and candidate.site.other is None and effect.signal in ("qd", "qdd", "load")


def has_direction(candidate: Candidate) -> bool:
    """Say whether a term is a curve that changes its sign with the velocity."""
    return isinstance(candidate.effect, SmoothTorque) and candidate.effect.friction


def has_friction(candidate: Candidate) -> bool:
    """Say whether a term is a curve that may hold a part of baseline friction."""
    return could_absorb_baseline(candidate) or has_direction(candidate)


def depends_on(candidate: Candidate, joint_names: Sequence[str]) -> tuple[str, ...]:
    """Return the signals that a curve depends on, e.g. "q_joint2"."""
    effect, site = candidate.effect, candidate.site
    assert isinstance(effect, SmoothTorque)
    assert site.joint is not None
    if effect.signal == "t":
        return ("t",)
    name = "tau" if effect.signal == "load" else effect.signal
    first = f"{name}_{joint_names[site.joint if site.other is None else site.other]}"
    also = [f"qd_{joint_names[site.joint]}"] if effect.friction else []
    own = [f"{name}_{joint_names[site.joint]}"] if effect.times_own else []
    return (first, *also, *own)


def _candidates(rows: Rows) -> Iterator[Candidate]:
    """Yield functions of each signal, with knots over the range that the rows cover."""
    columns = rows.columns
    signals = {"q": rows.q, "qd": rows.qd}
    signals |= {key: rows.evaluated(lambda s, key=key: getattr(s, key)) for key in ("qdd", "load")}
    for effect in SMOOTH:
        for site in effect.sites(columns.robot, [Window(name) for name in rows.seen_recordings]):
            assert site.joint is not None
            if not rows.seen[site.joint]:
                continue
            if effect.signal == "t":
                assert site.window is not None
                v = rows.t[rows.recording == rows.recordings.index(site.window.recording)]
            else:
                v = signals[effect.signal][site.other if site.other is not None else site.joint]
            rate = effect.signal == "qd"
            shape = _ends("low", "high", v, rate=rate)
            if effect.times_own:
                shape |= _ends("own_low", "own_high", signals[effect.signal][site.joint], rate=rate)
            if shape["high"] > shape["low"] and shape.get("own_high", 1.0) > shape.get("own_low", 0.0):
                yield columns.candidate(effect, site, shape)


def _ends(lower: str, upper: str, v: np.ndarray, *, rate: bool) -> dict[str, float]:
    """Return the ends of what a signal covers by name; those of a velocity are alike, so that zero is in the middle."""
    low, high = map(float, np.quantile(v, _ENDS))
    most = max(-low, high)
    return {lower: -most, upper: most} if rate else {lower: low, upper: high}
