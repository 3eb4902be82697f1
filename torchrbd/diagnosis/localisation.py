"""Where a model and the robot differ, before anything is named.

Hypotheses without a law are searched for in the noise of the discrepancy, as effects are: a torque, or friction, at a
joint for a time; friction that settles; a delay; a mass, or a force, on a link for a time; and smooth curves over the
state.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from torchrbd.dataset.columns import Candidate
from torchrbd.dataset.rows import Rows
from torchrbd.diagnosis.attack import attack
from torchrbd.diagnosis.curve_hypotheses import depends_on, is_curve, is_of_time
from torchrbd.diagnosis.curves import loudest_part
from torchrbd.diagnosis.hypotheses import Hypothesis
from torchrbd.diagnosis.outcome import SearchOutcome, Term
from torchrbd.diagnosis.results import Attack, Curve, Location, Region, ResidualMap, Where
from torchrbd.diagnosis.search import Search
from torchrbd.effects import Effect, effect
from torchrbd.effects.nameless import FORCE_AT_POINT, FRICTION_FOR_A_TIME
from torchrbd.effects.smooth_torque import HUM, SmoothTorque
from torchrbd.likelihood.likelihood import Likelihood
from torchrbd.robot.units import torque_unit

_PAYLOAD = effect("payload")
_FORMS: dict[Effect, str] = {
    effect("torque_offset"): "level",
    FRICTION_FOR_A_TIME: "friction",
    effect("time_varying_friction"): "friction",
    effect("time_delay"): "delay",
    _PAYLOAD: "payload",
    FORCE_AT_POINT: "force",
}
"""Hypotheses without a law, and what each is called."""
# A joint is named with a link where the torque of what acts on the link is at least this part of the residual.
_FELT = 0.5
# Points of a curve between two knots, and bins that show where a curve acts.
_POINTS, _PARTS = 10, 30
# Bins of a map, rows that each has on average, and rows that make a level.
_BINS, _FEWEST_BINS, _ROWS_IN_BIN, _LEAST_ROWS = 48, 4, 6, 2


def locate(
    found: SearchOutcome, report: Callable[[float], None] = lambda _: None
) -> tuple[tuple[Location, ...], tuple[ResidualMap, ...]]:
    """Locate what the rigid body with baseline friction leaves, and what the model of a search leaves.

    Args:
        found: by the search.
        report: called after each step with the part of the work that is done.

    Returns:
        The locations of each model, largest gain first, and maps of both residuals over time, position and velocity.
    """
    first, fit = _without_laws(found, report)
    rest = [_as_in(found.fit, k, t.own) for k, t in enumerate(found.terms) if is_curve(t.own.candidate)]
    # The report has its own entries for tones, and for what changes with time.
    over_states = (h for h in rest if h.candidate.effect is not HUM and not is_of_time(h.candidate))
    after = [_location("extended", h, found.fit, found.rows) for h in over_states]
    noise = [float(np.std(fit.residual(j)[m])) if m.any() else math.nan for j, m in enumerate(found.rows.measured)]
    maps = (*residual_maps("rigid_body", found.base, noise), *residual_maps("extended", found.fit, noise))
    ordered = (sorted(each, key=lambda one: -one.gain) for each in (first, after))
    return tuple(one for each in ordered for one in each), maps


def _without_laws(found: SearchOutcome, report: Callable[[float], None]) -> tuple[list[Location], Likelihood]:
    """Return the locations that hypotheses without a law find in the base, and the model with these."""
    search = Search(found.discrepancy.rows, list(_FORMS), found.discrepancy, lambda part, _: report(part))
    chosen, _ = search.improve([], search.rank([]))
    chosen = search.with_other_curves(chosen)
    every = [*search.conditional(chosen), *search.own_curves(chosen)]
    fit, kept = search.final([Term(h, ()) for h in every])
    located = [_as_in(fit, k, term.own) for k, term in enumerate(kept)]

    def point(c: Candidate) -> Attack | None:
        if c.site.body is None:
            return None
        others = search.fit([h for h in chosen if h.candidate is not c])
        return attack(others, search.rows, c, payload=c.effect is _PAYLOAD)

    return [_location("rigid_body", h, fit, search.rows, point(h.candidate)) for h in located], fit


def _as_in(fit: Likelihood, k: int, h: Hypothesis) -> Hypothesis:
    """Return a hypothesis with the coefficients of the k-th additional columns of a fit."""
    std = np.sqrt(fit.coefficients_covariance(k).diagonal())
    return replace(h, coefficients=fit.coefficients(k), std=std)


def _location(model: str, h: Hypothesis, fit: Likelihood, rows: Rows, point: Attack | None = None) -> Location:
    """Describe a hypothesis.

    Args:
        model: whose residual it explains.
        h: the hypothesis.
        fit: the model with it.
        rows: those of the hypothesis.
        point: of attack.
    """
    robot, site = rows.columns.robot, h.candidate.site
    torque, names = _torque(h, rows), robot.joint_names
    left = np.stack([fit.residual(j) for j in range(rows.n_dof)])
    count = np.maximum(rows.measured.sum(1), 1)
    own, after, before = (np.sqrt((x**2).sum(1) / count) for x in (torque * rows.measured, left, left + torque))
    seen = sorted((j for j in range(rows.n_dof) if rows.seen[j]), key=lambda j: -own[j] / max(after[j], 1e-300))
    felt = [j for j in seen if own[j] > _FELT * after[j]] or seen[:1]
    if site.joint is not None:
        felt = [site.joint]
    curve = _curve(h, rows)
    region = None if curve is None else Region(curve.signal, *_interval(h, rows, (left + torque)[felt[0]]))
    return Location(
        model=model,
        joints=tuple(names[j] for j in felt),
        links=() if site.body is None else (robot.body_names[site.body],),
        where=_where(h, rows, region),
        depends_on=_depends_on(h, names),
        form=_form(h),
        course="abrupt" if site.window is not None else "slow" if h.candidate.effect.of_conditions else "",
        gain=h.log_evidence,
        torque_rms={names[j]: float(own[j]) for j in felt},
        share={names[j]: _share(float(before[j]), float(after[j])) for j in felt},
        curve=curve,
        attack=point,
        unit=torque_unit(robot, felt[0]),
    )


def _form(h: Hypothesis) -> str:
    e = h.candidate.effect
    return "friction" if isinstance(e, SmoothTorque) and e.friction else _FORMS.get(e, "level")


def _depends_on(h: Hypothesis, names: Sequence[str]) -> tuple[str, ...]:
    """Return the signals that size depends on, "t" if only the time matters."""
    c = h.candidate
    if is_curve(c):
        return depends_on(c, names)[:1]
    return ("t",) if c.site.window is not None or c.effect.of_conditions else ()


def _torque(h: Hypothesis, rows: Rows) -> np.ndarray:
    """Return the torque (n, M) of a hypothesis."""
    own = np.tensordot(h.coefficients, rows.features(h.candidate), 1)
    if h.candidate.place is None:
        return own
    torque = np.zeros_like(rows.tau)
    torque[h.candidate.place] = own
    return torque


def _share(before: float, after: float) -> float:
    """Return the part of a residual's power that vanishes, of its RMS before and after."""
    return min(max(1.0 - (after / before) ** 2, 0.0), 1.0) if before > 0.0 else 0.0


def _interval(h: Hypothesis, rows: Rows, left: np.ndarray) -> tuple[float, float]:
    """Return the interval of its signal in which a curve acts most.

    Knots of a curve may be far apart. So the residual without it, (M,) at its joint, is averaged in bins of the signal
    that hold equally many rows; as a factor of sign(qd) if it is friction.
    """
    c = h.candidate
    assert isinstance(c.effect, SmoothTorque)
    effect, joint = c.effect, c.site.joint if c.site.other is None else c.site.other
    assert joint is not None
    v = rows.evaluated(lambda signals: effect.values(signals, joint))
    factor = rows.evaluated(lambda s: s.joint(c.joint).direction()) if effect.friction else np.ones_like(v)
    edges = np.unique(np.quantile(v, np.linspace(0.0, 1.0, _PARTS + 1)))
    bins = len(edges) - 1
    which = np.clip(np.digitize(v, edges) - 1, 0, bins - 1)
    own, power = (np.bincount(which, x * rows.measured[c.joint], bins) for x in (factor * left, factor**2))
    first, last = loudest_part(np.arange(float(bins)), own / np.maximum(power, 1e-300))
    return float(edges[int(first)]), float(edges[int(last) + 1])


def _where(h: Hypothesis, rows: Rows, region: Region | None) -> Where:
    """Return recordings, times and region; no recording where there is only one."""
    window, recordings = h.candidate.site.window, h.candidate.site.recordings
    if window is None:
        return Where(recordings, None, None if region is None else (region,))
    t = rows.t[rows.recording == rows.recordings.index(window.recording)]
    span = round(max(window.start_s, float(t[0])), 2), round(min(window.end_s, float(t[-1])), 2)
    whole = math.isinf(window.start_s) and math.isinf(window.end_s)
    return Where((window.recording,) if len(rows.seen_recordings) > 1 else None, None if whole else (span,))


def _curve(h: Hypothesis, rows: Rows) -> Curve | None:
    """Return a smooth function of one signal; between its knots it is linear."""
    c = h.candidate
    if not isinstance(c.effect, SmoothTorque) or c.effect.times_own or c.effect.signal == "t":
        return None
    knots = np.linspace(c.shape["low"], c.shape["high"], len(h.coefficients))
    at = np.linspace(knots[0], knots[-1], _POINTS * (len(knots) - 1) + 1)
    values = (at, *(np.interp(at, knots, x) for x in (h.coefficients, h.std)))
    return Curve(depends_on(c, rows.columns.robot.joint_names)[0], *(tuple(map(float, x)) for x in values))


def residual_maps(model: str, fit: Likelihood, noise: Sequence[float]) -> tuple[ResidualMap, ...]:
    """Return maps of a residual over the time of each recording, and over position and velocity.

    Args:
        model: its name.
        fit: the model.
        noise: (n,) standard deviation of the noise [N m or N].
    """
    rows, maps = fit.machine.rows, []
    left = np.stack([fit.residual(j) for j in range(rows.n_dof)])
    power = np.where(rows.measured, (left / np.maximum(noise, 1e-300)[:, None]) ** 2, np.nan)
    for name in rows.seen_recordings:
        here = rows.recording == rows.recordings.index(name)
        t = np.broadcast_to(rows.t[here], power[:, here].shape)
        maps.append(_map(model, "t", name, t, power[:, here], rows.dt_out))
    maps.append(_map(model, "q", "", rows.q, power, 0.0))
    maps.append(_map(model, "qd", "", rows.qd, power, 0.0))
    return tuple(maps)


def _map(model: str, signal: str, recording: str, v: np.ndarray, power: np.ndarray, pad: float) -> ResidualMap:
    """Return the root of the mean power (n, M) in bins of a signal v (n, M)."""
    edges, levels = [], []
    bins = int(np.clip(v.shape[1] // _ROWS_IN_BIN, _FEWEST_BINS, _BINS))
    for x, y in zip(v, power, strict=True):
        low, high = x.min() - pad / 2, x.max() + pad / 2
        edge = np.linspace(low, max(high, low + 1e-9), bins + 1)
        which = np.clip(np.searchsorted(edge, x, side="right") - 1, 0, bins - 1)
        seen = np.isfinite(y)
        count, total = np.bincount(which[seen], minlength=bins), np.bincount(which[seen], y[seen], bins)
        mean = np.where(count >= _LEAST_ROWS, total / np.maximum(count, 1), np.nan)
        edges.append(tuple(edge.tolist()))
        levels.append(tuple(np.sqrt(mean).tolist()))
    return ResidualMap(model, signal, recording, tuple(edges), tuple(levels))
