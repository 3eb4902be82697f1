"""Stretches of time in which something may act that does not act at other times, for a search to try."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from torchrbd.diagnosis.locate.clock import Clock
from torchrbd.diagnosis.locate.intervals import Interval, gains
from torchrbd.diagnosis.locate.scene import Scene
from torchrbd.diagnosis.locate.search import Search, coefficients, common_noise, each_body, enough
from torchrbd.diagnosis.locate.signals import form_columns
from torchrbd.diagnosis.rows.regression import Fit
from torchrbd.diagnosis.rows.white_rows import Rows
from torchrbd.physics import Window

# Stretches that overlap more than SAME, over their union, are one; one that is located by more than EQUAL.
MOST_STRETCHES, EACH, SAME, EQUAL = 4, 2, 0.6, 0.9
# Where no joint moves by more than this part of its range, friction may hold whatever it can.
AT_REST = 0.01


def stretches(fit: Fit) -> list[Window]:
    """Return the stretches in which a load, a force, a torque or friction explains most of what a fit leaves.

    They are of one recording each, all of it where there are several; best first. None is returned where nothing gains
    more than its freedom costs, or nothing moves. The one in which the leftover is located comes first: there each body
    is tried, with the noise that is left beside it.
    """
    if not enough(fit):
        return []
    search = Search(fit)
    scene, clock = search.scene, search.clock
    search.run(most=1)
    located = [p.stretch for p in search.parts if p.stretch is not None and not _at_rest(clock, p.stretch)]
    clear = Fit(Rows(scene.samples, fit.rows.prior, common_noise(fit)), fit.terms, fit.extra)
    found: list[tuple[Interval, Mapping[int, np.ndarray] | np.ndarray]] = []
    for features in (scene.carried, scene.pressed):
        found += [(one, features) for one in _best(clear, clock, _at(features[scene.outermost], scene))]
    for j in scene.seen:
        for form in ("level", "friction"):
            phi = {j: form_columns(scene, j, form)}
            found += [(one, phi) for one in _best(clear, clock, phi)]
    chosen: list[Interval] = []
    for one, features in sorted(found, key=lambda pair: -pair[0].gain):
        if len(located) + len(chosen) < MOST_STRETCHES and not any(_overlap(one, other) > SAME for other in chosen):
            sharp = _sharp(clear, clock, features, one)
            known = any(_overlap(sharp, other) > EQUAL for other in located)
            chosen += [] if known or _at_rest(clock, sharp) else [sharp]
    return [clock.window(one) for one in (*located, *chosen)]


def _at(features: np.ndarray, scene: Scene) -> dict[int, np.ndarray]:
    """Return features (n, K, M) of all joints by joint."""
    return {j: features[j] for j in scene.seen}


def _best(fit: Fit, clock: Clock, phi: Mapping[int, np.ndarray]) -> Iterator[Interval]:
    """Yield the best stretches, each apart from those before."""
    edges = clock.coarse.edges
    a, b, gain = gains(fit, phi, clock.coarse.steps, clock.coarse.allowed, clock.coarse.count)
    low, high, free = edges[a], edges[b], gain > 0
    for _ in range(EACH):
        if not free.any():
            return
        k = int(np.argmax(np.where(free, gain, -np.inf)))
        best = Interval(float(low[k]), float(high[k]), float(gain[k]))
        yield best
        common = np.clip(np.minimum(high, best.high) - np.maximum(low, best.low), 0, None)
        free &= common <= SAME * (high - low + best.high - best.low - common)


def _at_rest(clock: Clock, stretch: Interval) -> bool:
    """Say whether the robot rests all through a stretch."""
    q = clock.scene.samples.q
    inside = q[:, (clock.axis >= stretch.low) & (clock.axis <= stretch.high)]
    return not inside.size or bool((np.ptp(inside, axis=1) <= AT_REST * np.ptp(q, axis=1)).all())


def _overlap(a: Interval, b: Interval) -> float:
    common = max(0.0, min(a.high, b.high) - max(a.low, b.low))
    return common / (a.high - a.low + b.high - b.low - common)


def _sharp(fit: Fit, clock: Clock, features: Mapping[int, np.ndarray] | np.ndarray, found: Interval) -> Interval:
    """Return a stretch with its ends where the best mixture of features begins and ends, on the best of bodies."""
    inside = clock.inside(found)
    if isinstance(features, np.ndarray):
        _, body, w = max(each_body(fit, features * inside, clock.scene.seen), key=lambda one: one[0])
        phi = _at(features[body], clock.scene)
    else:
        phi = features
        _, w = coefficients(fit, {j: f * inside for j, f in phi.items()})
    return clock.sharpened(fit, {j: (w @ f)[None] for j, f in phi.items()}, replace(found, gain=-np.inf))
