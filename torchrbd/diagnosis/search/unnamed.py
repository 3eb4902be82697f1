"""Torque without a name: smooth functions of what the leftover may depend on, offered where names have ended."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from torchrbd.diagnosis.locate.hum import lines
from torchrbd.diagnosis.rows.regression import Fit
from torchrbd.diagnosis.rows.samples import Samples
from torchrbd.diagnosis.search.options import BACKGROUND
from torchrbd.likelihood.columns import Candidate
from torchrbd.physics import Site, Window
from torchrbd.physics.smooth_torque import HUM, SMOOTH, SmoothTorque

# Beyond these quantiles of a signal there are too few samples to tell a function.
ENDS = (0.01, 0.99)


def smooth_candidates(samples: Samples, measured: Sequence[bool]) -> Iterator[Candidate]:
    """Yield functions of each signal, with knots over the range that the samples cover."""
    columns = samples.columns
    recordings = [(k, Window(samples.recordings[k])) for k in np.unique(samples.recording)]
    load = samples.supplied(samples.load_parameters, None)
    signals = {"q": samples.q, "qd": samples.qd, "qdd": samples.qdd, "load": load}
    for effect in SMOOTH:
        for site in effect.sites(columns.robot, [w for _, w in recordings]):
            assert site.joint is not None
            if not measured[site.joint]:
                continue
            if effect.signal == "t":
                (k,) = (k for k, w in recordings if w == site.window)
                v = samples.t[samples.recording == k]
            else:
                v = signals[effect.signal][site.other if site.other is not None else site.joint]
            rate = effect.signal == "qd"
            shape = _ends("low", "high", v, rate=rate)
            if effect.times_own:
                shape |= _ends("own_low", "own_high", signals[effect.signal][site.joint], rate=rate)
            if shape["high"] > shape["low"] and shape.get("own_high", 1.0) > shape.get("own_low", 0.0):
                yield columns.candidate(effect, site, shape)


def humming(fit: Fit) -> Iterator[Candidate]:
    """Yield the hums in what a fit leaves: unmodelled, they shake the robot, and names take what they do."""
    samples = fit.rows.samples
    for joint, line in lines(fit):
        for k in np.unique(samples.recording):
            site = Site(joint, window=Window(samples.recordings[k]))
            yield samples.columns.candidate(HUM, site, {"frequency": line.frequency_hz})


def _ends(lower: str, upper: str, v: np.ndarray, *, rate: bool) -> dict[str, float]:
    """Return the ends of what a signal covers by name; those of a velocity are alike, so that zero is in the middle."""
    low, high = map(float, np.quantile(v, ENDS))
    most = max(-low, high)
    return {lower: -most, upper: most} if rate else {lower: low, upper: high}


def is_smooth(candidate: Candidate) -> bool:
    """Say whether a term is a function without a law."""
    return isinstance(candidate.effect, SmoothTorque)


def proper(terms: Iterable[Candidate]) -> tuple[Candidate, ...]:
    """Return the terms that are names beside plain friction, and have a law."""
    return tuple(c for c in terms if c.effect.id not in BACKGROUND and not is_smooth(c))


def depends_on(candidate: Candidate, joint_names: Sequence[str]) -> tuple[str, ...]:
    """Return the signals that a smooth term depends on, e.g. "q_joint2"."""
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
