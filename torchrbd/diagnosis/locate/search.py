"""Explain a residual part by part, each by the place that gains most: a signal, a window of time, or a body.

A part that is found joins the fit, and the search continues on the new residual. So no joint is named whose residual
only reflects that of another joint, through the parameters that they share.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from torchrbd.diagnosis.decisions import DECISIONS
from torchrbd.diagnosis.locate.clock import Clock
from torchrbd.diagnosis.locate.intervals import Interval, signal_interval
from torchrbd.diagnosis.locate.scene import Scene
from torchrbd.diagnosis.locate.signals import LEAST_SHARE, Bases, Signal, Smooth, form_columns, smooth
from torchrbd.diagnosis.rows.regression import Extra, Fit
from torchrbd.diagnosis.rows.white_rows import LEAST_NOISE, Colour, Rows
from torchrbd.likelihood.gaussian import Posterior

# Less at first, and less than this part of the best, need not be looked at closer.
LEAST_START, SHORT_OF_BEST, ROUNDS, SHARPENINGS = 4.0, 0.25, 1, 2
# Rows that are needed for each coefficient of the model.
LEAST_ROWS = 2
# Torque sensors drift: a slow level must gain so much more.
DRIFT_COST = 15.0
MOST_PARTS, SHORTLIST, WINDOWS = 5, 6, 3
# A function is confined to an interval if one without freedom there, nothing elsewhere, gains this part as much.
# An interval that holds this part of all samples is none.
REGION_PART, MOST_OF_A_SIGNAL = 0.7, 0.9
TIME_FORMS = ("level", "friction", "load")


@dataclass(frozen=True)
class Part:
    """One part of a residual.

    Attributes:
        joints: where it acts; several for a body.
        gain: log-likelihood units beyond those of its freedom and of the search.
        form: what acts there: "level", "friction", "load", "payload" or "force".
        cost: of its freedom and of the search, in the same units.
        columns: (K, M) by joint; a body's coefficients are the same at all joints.
        smooth: the function of a signal, if that is what it is.
        window: the window of time, if it acts in one.
        body: on which it acts.
        region: the interval of the signal to which the function is confined; None if it is not.
    """

    joints: tuple[int, ...]
    gain: float
    form: str
    cost: float
    columns: Mapping[int, np.ndarray]
    smooth: Smooth | None = None
    window: Interval | None = None
    body: int | None = None
    region: Interval | None = None

    @property
    def extra(self) -> tuple[Extra, ...]:
        """Return its columns for a fit."""
        if self.body is not None:
            return (Extra(None, np.stack(list(self.columns.values()), axis=1)),)
        return tuple(Extra(j, A) for j, A in self.columns.items())


class Search:
    """The search for the parts of a fit's residual.

    Args:
        fit: whose residual is explained.

    Attributes:
        scene, clock: of its samples.
        parts: in the order found.
        fit: with these parts, whitened by its residual.
    """

    def __init__(self, fit: Fit) -> None:
        self.scene, self.fit = Scene.of(fit), fit
        self.clock = Clock(self.scene)
        self.parts: tuple[Part, ...] = ()
        self._bases = {j: Bases(self.scene, j) for j in self.scene.seen}

    def run(self, most: int = MOST_PARTS) -> None:
        """Find part after part, so many at most."""
        for _ in range(most if enough(self.fit) else 0):
            found = self._best(list(self._candidates(self._clear())))
            if found is None or found[0].gain < DECISIONS.location_gain:
                break
            part, after = found
            # The part has coloured the noise: choose its place again with the noise of the residual without it.
            joints = part.joints if part.body is None else self.scene.seen
            clear = Fit(after.rows, self.fit.terms, self.fit.extra)
            again = [p for p in self._candidates(clear, joints) if (p.body is None) == (part.body is None)]
            part, fit = self._best([part, *again]) or found
            if part.smooth is not None and part.smooth.signal.name != "t":
                region = self._region(Fit(fit.rows, self.fit.terms, self.fit.extra), part.joints[0], part.smooth.signal)
                part = replace(part, region=region)
            self.parts, self.fit = (*self.parts, part), fit

    def fit_with(self, parts: Sequence[Part], rows: Rows | None = None) -> Fit:
        """Return the fit of the terms and some parts, whitened as the last one if no rows are given."""
        return Fit(rows or self.fit.rows, self.fit.terms, [e for part in parts for e in part.extra])

    def _clear(self) -> Fit:
        """Return the fit with the noise that serves to find candidates."""
        rows = self.fit.rows
        return Fit(Rows(rows.samples, rows.prior, common_noise(self.fit)), self.fit.terms, self.fit.extra)

    def _best(self, candidates: Sequence[Part]) -> tuple[Part, Fit] | None:
        """Return the part that fits best when the noise is estimated with it, and the fit with it."""
        ranked = sorted(candidates, key=lambda p: -p.gain)
        ranked = [p for p in ranked if p.gain > max(LEAST_START, SHORT_OF_BEST * ranked[0].gain)]
        firsts = {p.joints: p for p in reversed(ranked)}
        best, before = None, log_likelihood(self.fit)
        for part in {id(p): p for p in (*ranked[:SHORTLIST], *firsts.values())}.values():
            rows, extra = self.fit.rows, (*self.fit.extra, *part.extra)
            after = Fit(rows, self.fit.terms, extra)
            for _ in range(ROUNDS):
                after = Fit(Rows(rows.samples, rows.prior, after.noise()), self.fit.terms, extra)
            gain = log_likelihood(after) - before - part.cost
            if best is None or gain > best[0].gain:
                best = replace(part, gain=gain), after
        return best

    def _region(self, fit: Fit, joint: int, signal: Signal) -> Interval | None:
        """Return the interval outside which the function of a signal is not needed, if there is one."""
        phi = form_columns(self.scene, joint, signal.form)
        v = (signal.v - signal.v.mean()) / max(float(signal.v.std()), 1e-300)
        powers = np.concatenate([phi * v**k for k in range(4)])
        inside = [signal_interval(fit, joint, powers[: k * len(phi)], signal.v) for k in (1, 2, 3)]
        best = max(inside, key=lambda o: o.gain)
        everywhere = coefficients(fit, {joint: powers})[0] - _freedom(len(powers), fit.rows.counts[joint])
        everything = best.inside(signal.v).mean() > MOST_OF_A_SIGNAL
        if everything or best.gain <= max(REGION_PART * smooth(fit, self.scene, joint, signal).gain, everywhere):
            return None
        open_ended = best.low <= signal.v.min() or best.high >= signal.v.max()
        hump = best is inside[2] and not open_ended
        return _half_height(fit, joint, powers[: 3 * len(phi)], signal.v, best) if hump else best

    def _candidates(self, fit: Fit, joints: Sequence[int] | None = None) -> Iterator[Part]:
        """Yield what may explain the residual of joints, of all by default."""
        windows, counts = [], fit.rows.counts
        for j in self.scene.seen if joints is None else joints:
            for one in self._bases[j].smooths(fit):
                if one.gain > 0 and len(one.columns):
                    signal = one.signal
                    drift = DRIFT_COST if (signal.name, signal.form) == ("t", "level") else 0.0
                    cost = _freedom(len(one.columns), counts[j]) + drift
                    yield Part((j,), one.gain - drift, signal.form, cost, {j: one.columns}, smooth=one)
            for form in TIME_FORMS:
                phi = form_columns(self.scene, j, form)
                if not len(phi):
                    continue
                window = self.clock.scan(fit, {j: phi})
                windows.append(window)
                if window.gain > 0:
                    cost = _freedom(len(phi), counts[j]) + np.log(self.clock.fine.count)
                    acting = {j: phi * self.clock.inside(window)}
                    yield Part((j,), window.gain, form, cost, acting, window=window)
        if joints is None or len(joints) > 1:
            yield from self._bodies(fit, sorted(windows, key=lambda s: -s.gain)[:WINDOWS])

    def _bodies(self, fit: Fit, windows: Sequence[Interval]) -> Iterator[Part]:
        """Yield the body that a mass, a force at a point, or a force and a moment explain best in a window of time."""
        scene, seen = self.scene, self.scene.seen
        point = scene.held.reshape(*scene.held.shape[:2], 12, -1)
        mass = float(scene.robot.pi[::10].sum())
        # Nothing on an arm weighs more than the arm.
        kinds = ("payload", scene.carried, mass), ("force", point, 9.81 * mass), ("force", scene.pressed, 9.81 * mass)
        several = (
            self.clock.scan(fit, {j: f[scene.outermost, j] for j in seen}) for f in (scene.carried, scene.pressed)
        )
        windows = [s for s in (*windows, *several) if np.isfinite(s.gain)]
        for form, features, heaviest in kinds:
            # A load that is always there is the link's own.
            offered = [*windows, None] if form == "force" else windows
            options = [(*one, s) for s in offered for one in each_body(fit, features * self._inside(s), seen)]
            if not options:
                continue
            gain, body, w, window = max(options, key=lambda option: option[0])
            cost = _freedom(len(w), sum(fit.rows.counts)) + np.log(self.clock.fine.count * len(features))
            if gain <= cost or np.abs(w[: 1 if form == "payload" else 3]).max() > heaviest:
                continue
            phi = features[body]
            for _ in range(SHARPENINGS):
                if window is None:
                    break
                mixture = {j: (w @ phi[j])[None] for j in seen}
                window = self.clock.sharpened(fit, mixture, replace(window, gain=-np.inf))
                gain, w = coefficients(fit, {j: phi[j] * self.clock.inside(window) for j in seen})
            acting = {j: f * self._inside(window) for j, f in enumerate(phi)}
            joints = tuple(j for j, f in acting.items() if f.any())
            yield Part(joints, gain - cost, form, cost, acting, window=window, body=body)

    def _inside(self, window: Interval | None) -> np.ndarray | float:
        return 1.0 if window is None else self.clock.inside(window)


def enough(fit: Fit) -> bool:
    """Say whether there are enough rows for the coefficients that a fit has."""
    return len(fit.e) > LEAST_ROWS * fit.X.shape[1]


def each_body(fit: Fit, features: np.ndarray, seen: Sequence[int]) -> Iterator[tuple[float, int, np.ndarray]]:
    """Yield gain, body and coefficients (K,) of the features of each body, (n_bodies, n, K, M), at joints."""
    n_bodies, _, K, M = features.shape
    G, alone, u = fit.equations({j: features[:, j].reshape(-1, M) for j in seen})
    for body in range(n_bodies):
        at = slice(body * K, (body + 1) * K)
        gain, w = _gain_of(G[at, at], alone.diagonal()[at], u[at])
        yield gain, body, w


def common_noise(fit: Fit) -> Colour:
    """Return each joint's noise with the colour that most joints share; an effect colours the noise of its own joint.

    It serves to find candidates. These are then judged with the joint's own noise, estimated with them.
    """
    rows, left = fit.rows, fit.residual()
    seen = np.flatnonzero(rows.counts)
    filters, scale = rows.noise[0].copy(), rows.noise[1].copy()
    common = np.median(filters[seen], axis=0)
    for j in seen:
        weighted = left[j] * rows.samples.weight[j]
        plain = replace(rows.noises[j], sigma=1.0, spread=np.ones_like(weighted))
        e, own = (replace(plain, predictor=a).white(weighted) for a in (common, filters[j]))
        scale[j] *= np.sqrt(np.mean(e**2) / max(float(np.mean(own**2)), 1e-300))
        filters[j] = common
    return filters, scale


def log_likelihood(fit: Fit) -> float:
    """Return that of a fit, up to a constant: - sum_j m_j / 2 log(RSS_j / m_j)."""
    total, least = 0.0, LEAST_NOISE**2 * np.mean(fit.rows.samples.tau**2, axis=1)
    for j, (part, count) in enumerate(zip(fit.rows.parts, fit.rows.counts, strict=True)):
        if count > 0:
            variance = fit.rows.noise[1][j] ** 2 * float(np.sum(fit.e[part] ** 2)) / count + least[j]
            total -= 0.5 * count * float(np.log(max(variance, 1e-300)))
    return total


def coefficients(fit: Fit, phi: Mapping[int, np.ndarray]) -> tuple[float, np.ndarray]:
    """Return gain and coefficients (K,) of features (K, M) that joints share."""
    G, alone, u = fit.equations(phi)
    return _gain_of(G, alone.diagonal(), u)


def _gain_of(G: np.ndarray, alone: np.ndarray, u: np.ndarray) -> tuple[float, np.ndarray]:
    w = Posterior(G + LEAST_SHARE * np.diag(np.maximum(alone, 1e-300)), u).z
    return 0.5 * float(w @ u), w


def _half_height(fit: Fit, joint: int, phi: np.ndarray, v: np.ndarray, region: Interval) -> Interval:
    """Return where a hump within a region is higher than half of its peak."""
    here = region.inside(v) > 0
    _, w = coefficients(fit, {joint: phi * here})
    order = np.flatnonzero(here)[np.argsort(v[here])]
    height = np.abs((w @ phi)[order])
    high = np.flatnonzero(height > 0.5 * height.max())
    return replace(region, low=float(v[order[high[0]]]), high=float(v[order[high[-1]]]))


def _freedom(K: int, m: float) -> float:
    return 0.5 * K * np.log(max(m, 2))
