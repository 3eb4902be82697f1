"""Explain a leftover part by part, each by the place that gains most: a signal, a stretch of time, or a body.

A part that is found joins the fit, and the search goes on in what is left; so a joint whose leftover is only the shadow
of another's, cast by the parameters that they share, is not accused.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from torchrbd.diagnosis.locate.intervals import Clock, Interval, signal_interval
from torchrbd.diagnosis.locate.residual import Leftover, Noise, fit_rows, whitened
from torchrbd.diagnosis.locate.rows import Rows
from torchrbd.diagnosis.locate.signals import LEAST_SHARE, Signal, Smooth, form_columns, signals, smooth

# In log-likelihood units, beyond the costs of freedom and search: on 30 recordings with coloured noise and drift and
# nothing concealed the three largest were 9.6, 8.7 and 6.7.
LEAST_GAIN = 15.0
# Rows that are needed for each coefficient of the model.
LEAST_ROWS = 2
# Torque sensors drift: a slow level must gain so much more.
DRIFT_COST = 15.0
MOST_PARTS, SHORTLIST, STRETCHES, REFINING_ROUNDS = 5, 6, 3, 2
# A function is confined to an interval if one without freedom there, nothing elsewhere, gains this part as much.
# An interval that holds this part of all samples is none.
REGION_PART, MOST_OF_A_SIGNAL = 0.7, 0.9
TIME_FORMS = ("level", "friction", "load")
BODY_FORMS = ("payload", "force")


@dataclass(frozen=True)
class Part:
    """One part of a leftover.

    Attributes:
        joints: where it acts; several for a body.
        gain: log-likelihood units beyond those of its freedom and of the search.
        form: what acts there: "level", "friction", "load", "payload" or "force".
        cost: of its freedom and of the search, in the same units.
        columns: (M, K) by joint; a body's coefficients are the same at all joints.
        smooth: the function of a signal, if that is what it is.
        stretch: the stretch of time, if it acts in one.
        body: on which it acts.
        region: the interval of the signal to which the function is confined; None if it is not.
    """

    joints: tuple[int, ...]
    gain: float
    form: str
    cost: float
    columns: Mapping[int, np.ndarray]
    smooth: Smooth | None = None
    stretch: Interval | None = None
    body: int | None = None
    region: Interval | None = None


def search(rows: Rows) -> tuple[tuple[Part, ...], Leftover]:
    """Return the parts of what rigid body and friction leave, in the order found, and what is left beside them."""
    clock = Clock(rows)
    leftover = fit_rows(rows)
    parts: tuple[Part, ...] = ()
    freedom = leftover.basis[0].shape[1]
    for _ in range(MOST_PARTS if sum(map(len, leftover.e)) > LEAST_ROWS * freedom else 0):
        clear = refit(rows, parts, _common_noise(leftover), 0)
        found = _best(rows, leftover, parts, list(_candidates(clear, clock)))
        if found is None or found[0].gain < LEAST_GAIN:
            break
        part, after = found
        # What was found has coloured the noise: choose its place again with the noise that is left beside it.
        joints = part.joints if part.body is None else tuple(range(len(leftover.e)))
        clear = refit(rows, parts, after.noise, 0)
        again = [p for p in _candidates(clear, clock, joints) if (p.body is None) == (part.body is None)]
        part, leftover = _best(rows, leftover, parts, [part, *again]) or found
        if part.smooth is not None and part.smooth.signal.name != "t":
            clear = refit(rows, parts, leftover.noise, 0)
            part = replace(part, region=_region(clear, part.joints[0], part.smooth.signal))
        parts = (*parts, part)
    return parts, leftover


def refit(rows: Rows, parts: Sequence[Part], noise: Noise, rounds: int = REFINING_ROUNDS) -> Leftover:
    """Return what is left beside parts, the noise estimated anew in so many rounds."""
    added: dict[int, np.ndarray] = {}
    shared = []
    for part in parts:
        if part.body is None:
            for j, A in part.columns.items():
                added[j] = np.concatenate((added[j], A), axis=1) if j in added else A
        else:
            shared.append(np.stack([part.columns[j] for j in range(rows.q.shape[1])]))
    return fit_rows(rows, added, shared, noise, rounds)


def _common_noise(leftover: Leftover) -> Noise:
    """Return each joint's noise with the colour that most joints share: what hides in one has coloured its own.

    It serves to find candidates; what they are worth is judged with the joint's own noise, estimated beside them.
    """
    seen = [j for j, e in enumerate(leftover.e) if len(e)]
    filters, scale = leftover.filters.copy(), leftover.scale.copy()
    common = np.median(leftover.filters[seen], axis=0)
    for j in seen:
        e = whitened(np.nan_to_num(leftover.raw[:, j]), leftover.index[j], common, 1.0)
        own = whitened(np.nan_to_num(leftover.raw[:, j]), leftover.index[j], filters[j], 1.0)
        scale[j] *= np.sqrt(np.mean(e**2) / max(float(np.mean(own**2)), 1e-300))
        filters[j] = common
    return filters, scale


def _best(
    rows: Rows, leftover: Leftover, parts: tuple[Part, ...], candidates: Sequence[Part]
) -> tuple[Part, Leftover] | None:
    """Return the part that fits best when the noise is estimated beside it, and what it leaves."""
    ranked = sorted(candidates, key=lambda p: -p.gain)
    firsts = {p.joints: p for p in reversed(ranked)}
    best = None
    for part in {id(p): p for p in (*ranked[:SHORTLIST], *firsts.values())}.values():
        after = refit(rows, (*parts, part), leftover.noise)
        gain = after.log_likelihood - leftover.log_likelihood - part.cost
        if best is None or gain > best[0].gain:
            best = replace(part, gain=gain), after
    return best


def _region(leftover: Leftover, joint: int, signal: Signal) -> Interval | None:
    """Return the interval outside which the function of a signal is not needed, if there is one."""
    phi = form_columns(leftover.rows, joint, signal.form)
    v = (signal.v - signal.v.mean()) / max(float(signal.v.std()), 1e-300)
    powers = np.concatenate([phi * v[:, None] ** k for k in range(4)], axis=1)
    inside = [signal_interval(leftover, joint, powers[:, : k * phi.shape[1]], signal.v) for k in (1, 2, 3)]
    best = max(inside, key=lambda o: o.gain)
    everywhere = coefficients(leftover, {joint: powers})[0] - _freedom(powers.shape[1], len(leftover.e[joint]))
    everything = best.inside(signal.v).mean() > MOST_OF_A_SIGNAL
    if everything or best.gain <= max(REGION_PART * smooth(leftover, joint, signal).gain, everywhere):
        return None
    return _half_height(leftover, joint, powers[:, : 3 * phi.shape[1]], signal.v, best) if best is inside[2] else best


def _half_height(leftover: Leftover, joint: int, phi: np.ndarray, v: np.ndarray, region: Interval) -> Interval:
    """Return where a hump within a region is higher than half of its peak."""
    here = region.inside(v) > 0
    _, w = coefficients(leftover, {joint: phi * here[:, None]})
    order = np.flatnonzero(here)[np.argsort(v[here])]
    height = np.abs((phi @ w)[order])
    high = np.flatnonzero(height > 0.5 * height.max())
    return replace(region, low=float(v[order[high[0]]]), high=float(v[order[high[-1]]]))


def _candidates(leftover: Leftover, clock: Clock, joints: Sequence[int] | None = None) -> Iterator[Part]:
    """Yield what may explain the leftover of joints, of all by default."""
    rows, stretches = leftover.rows, []
    for j in range(rows.q.shape[1]) if joints is None else joints:
        if not len(leftover.e[j]):
            continue
        for signal in signals(rows, j):
            one = smooth(leftover, j, signal)
            if one.gain > 0 and one.columns.shape[1]:
                drift = DRIFT_COST if (signal.name, signal.form) == ("t", "level") else 0.0
                cost = _freedom(one.columns.shape[1], len(leftover.e[j])) + drift
                yield Part((j,), one.gain - drift, signal.form, cost, {j: one.columns}, smooth=one)
        for form in TIME_FORMS:
            phi = form_columns(rows, j, form)
            if not phi.shape[1]:
                continue
            stretch = clock.scan(leftover, {j: phi})
            stretches.append(stretch)
            if stretch.gain > 0:
                columns = {j: phi * clock.inside(stretch)}
                cost = _freedom(phi.shape[1], len(leftover.e[j])) + np.log(clock.fine.count)
                yield Part((j,), stretch.gain, form, cost, columns, stretch=stretch)
    yield from _bodies(leftover, clock, sorted(stretches, key=lambda s: -s.gain)[:STRETCHES])


def _freedom(K: int, m: int) -> float:
    return 0.5 * K * np.log(max(m, 2))


def _bodies(leftover: Leftover, clock: Clock, stretches: Sequence[Interval]) -> Iterator[Part]:
    """Yield the body that a payload or a force explains best in each of some stretches of time."""
    rows = leftover.rows
    n = rows.q.shape[1]
    seen = [j for j in range(n) if len(leftover.e[j])]
    m = sum(len(leftover.e[j]) for j in seen)
    mass = float(rows.robot.pi[::10].sum())
    # Nothing on an arm weighs more than the arm.
    heaviest = {"payload": mass, "force": 9.81 * mass}
    for form in BODY_FORMS:
        columns = rows.carried if form == "payload" else rows.held.reshape(*rows.held.shape[:3], -1)
        options = []
        # A load that is always there is the link's own.
        for stretch in (*stretches, None) if form == "force" else stretches:
            inside = 1.0 if stretch is None else clock.inside(stretch)
            for body in range(columns.shape[2]):
                gain, w = coefficients(leftover, {j: columns[j, :, body] * inside for j in seen})
                options.append((gain, body, stretch, w))
        gain, body, stretch, w = max(options, key=lambda option: option[0])
        cost = _freedom(len(w), m) + np.log(clock.fine.count * columns.shape[2])
        size = np.abs(w[:1] if form == "payload" else w[:3]).max()
        if gain <= cost or size > heaviest[form]:
            continue
        phi = {j: columns[j, :, body] for j in range(n)}
        for _ in range(2 if stretch is not None else 0):
            stretch = clock.scan(leftover, {j: phi[j] @ w[:, None] for j in seen})
            gain, w = coefficients(leftover, {j: phi[j] * clock.inside(stretch) for j in seen})
        inside = 1.0 if stretch is None else clock.inside(stretch)
        acting = {j: phi[j] * inside for j in range(n)}
        joints = tuple(j for j in range(n) if phi[j].any())
        yield Part(joints, gain - cost, form, cost, acting, stretch=stretch, body=body)


def coefficients(leftover: Leftover, phi: Mapping[int, np.ndarray]) -> tuple[float, np.ndarray]:
    """Return gain and coefficients (K,) of features that joints share."""
    G, alone, u = leftover.equations({j: leftover.white(j, A) for j, A in phi.items()})
    size = np.sqrt(np.maximum(alone.diagonal(), 1e-300))
    w = np.linalg.solve(G / size / size[:, None] + LEAST_SHARE * np.eye(len(u)), u / size)
    return 0.5 * float(w @ (u / size)), w / size
