"""Say where a model and the robot still differ, before anything is named."""

from __future__ import annotations

import numpy as np

from torchrbd.diagnosis.locate.attack import attack
from torchrbd.diagnosis.locate.clock import Clock
from torchrbd.diagnosis.locate.maps import residual_maps
from torchrbd.diagnosis.locate.search import Part, Search, coefficients
from torchrbd.diagnosis.locate.signals import Smooth, smooth
from torchrbd.diagnosis.results import Curve, Location, Region, ResidualMap, Where
from torchrbd.diagnosis.rows.regression import Fit
from torchrbd.diagnosis.rows.white_rows import Rows
from torchrbd.robot.units import torque_unit

# A joint is named with a body where the body's torque is at least this part of the noise. A recording is named where
# the part gains at least this much of its gain in the best recording.
_FELT, _LOUD = 0.5, 0.2


def locate(fit: Fit, model: str = "rigid_body") -> tuple[tuple[Location, ...], tuple[ResidualMap, ...]]:
    """Locate the residual of a fit.

    Args:
        fit: with its terms, samples (their weights included) and noise.
        model: its name.

    Returns:
        The locations, largest gain first, and maps of the residual over time, position and velocity.
    """
    search = Search(fit)
    search.run()
    rows, parts = search.fit.rows, search.parts
    # Sizes are those of a plain fit: one that expects drift leaves levels that mean nothing.
    plain = Rows(rows.samples, rows.prior, (np.zeros_like(rows.noise[0]), rows.noise[1]))
    quiet = search.fit_with(parts, plain).residual()
    found = []
    for part in parts:
        others = [p for p in parts if p is not part]
        left = search.fit_with(others, plain).residual()
        found.append(_location(search, part, search.fit_with(others), left, quiet, model))
    left = _counted(search.fit_with((), plain).residual(), rows)
    maps = residual_maps(search.scene, left, _std(_counted(quiet, rows)), model)
    return tuple(sorted(found, key=lambda x: -x.gain)), maps


def _location(search: Search, part: Part, without: Fit, left: np.ndarray, quiet: np.ndarray, model: str) -> Location:
    """Describe a part.

    Args:
        search: that found it.
        part: what was found.
        without: the fit with all other parts.
        left: (n, M) residual of a plain fit without the part.
        quiet: (n, M) residual of a plain fit with all parts.
        model: the model's name.
    """
    scene, rows = search.scene, without.rows
    robot, joints = scene.robot, scene.robot.joint_names
    seen = [j for j in part.joints if j in scene.seen]
    # What the rest of the model would absorb of a part is not seen, and not counted.
    visible = left - quiet
    measured = rows.samples.measured
    rms = np.sqrt(np.sum(visible**2, axis=1, where=measured) / np.maximum(measured.sum(1), 1))
    loudness = rms / np.maximum(_std(_counted(quiet, rows)), 1e-300)
    prominent = sorted(seen, key=lambda j: -loudness[j])
    felt = [j for j in prominent if loudness[j] > _FELT] or prominent[:1]
    where, depends_on, curve = _where(search.clock, part, without), (), None
    if part.smooth is not None:
        depends_on = (part.smooth.signal.name,)
        if depends_on != ("t",):
            curve = _curve(smooth(without, scene, part.joints[0], part.smooth.signal))
    elif part.window is not None:
        depends_on = ("t",)
    links, hit = (), None
    if part.body is not None:
        links = (robot.body_names[part.body],)
        hit = attack(without, _touched(search, part), part.form, robot.gravity.numpy())
    course = "abrupt" if part.window else "slow" if depends_on == ("t",) else ""
    unit = torque_unit(robot, felt[0])
    names = tuple(joints[j] for j in felt)
    share = _share(_counted(visible, rows), _counted(left, rows))
    return Location(
        model=model,
        joints=names,
        links=links,
        where=where,
        depends_on=depends_on,
        form=part.form,
        course=course,
        gain=part.gain,
        torque_rms={joints[j]: float(rms[j]) for j in felt},
        share={joints[j]: float(share[j]) for j in felt},
        curve=curve,
        attack=hit,
        unit=unit,
    )


def _touched(search: Search, part: Part) -> dict[int, np.ndarray]:
    """Return what a mass, or a force at a point, on the body of a part takes at each joint, (K, M)."""
    scene = search.scene
    held = scene.carried if part.form == "payload" else scene.held.reshape(*scene.held.shape[:2], 12, -1)
    inside = 1.0 if part.window is None else search.clock.inside(part.window)
    return {j: held[part.body, j] * inside for j in scene.seen}


def _where(clock: Clock, part: Part, without: Fit) -> Where:
    """Return recordings, times and region of a part."""
    if part.window is not None:
        recording, span = clock.place(part.window)
        return Where((recording,) if len(clock.numbers) > 1 else None, None if span is None else (span,))
    region = None
    if part.region is not None and part.smooth is not None:
        signal, v = part.smooth.signal.name, part.smooth.signal.v
        region = (Region(signal, max(part.region.low, float(v.min())), min(part.region.high, float(v.max()))),)
    return Where(_recordings(part, without), None, region)


def _counted(left: np.ndarray, rows: Rows) -> np.ndarray:
    """Return a residual (n, M) weighted by what its samples count, NaN where nothing is measured."""
    return np.where(rows.samples.measured, left * rows.samples.weight, np.nan)


def _std(left: np.ndarray) -> np.ndarray:
    """Return standard deviations (n,); NaN for a joint without torque."""
    count = np.isfinite(left).sum(1)
    mean = np.nansum(left, 1) / np.maximum(count, 1)
    power = np.nansum((left - mean[:, None]) ** 2, 1) / np.maximum(count, 1)
    return np.where(count > 0, np.sqrt(power), np.nan)


def _share(visible: np.ndarray, left: np.ndarray) -> np.ndarray:
    """Return the part of a residual's power that vanishes with a part, (n,)."""
    before, after = _std(left) ** 2, _std(left - visible) ** 2
    return np.clip(1.0 - after / np.where(before > 0, before, 1.0), 0.0, 1.0)


def _recordings(part: Part, without: Fit) -> tuple[str, ...] | None:
    """Return the recordings in which a part is seen, or None if it is in all of them."""
    rows, samples = without.rows, without.rows.samples
    columns = {j: A for j, A in part.columns.items() if rows.counts[j]}
    _, w = coefficients(without, columns)
    present = np.unique(samples.recording)
    # As it is given the fit, which absorbs a part of it.
    alone = np.zeros_like(without.e)
    for j, A in columns.items():
        alone[rows.parts[j]] = rows.white(w @ A, j)
    f = without.projected(alone)
    gain = np.zeros(len(present))
    for j in columns:
        here = rows.parts[j]
        of = np.searchsorted(present, samples.recording[rows.index[j]])
        total = np.bincount(of, without.e[here] * f[here] - 0.5 * f[here] ** 2, len(present))
        gain += total / np.maximum(np.bincount(of, minlength=len(present)), 1)
    loud = gain > _LOUD * gain.max()
    return None if loud.all() else tuple(samples.recordings[k] for k in present[loud])


def _curve(found: Smooth) -> Curve:
    return Curve(found.signal.name, *(tuple(map(float, x)) for x in (found.knots, found.mean, found.std)))
