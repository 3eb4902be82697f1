"""Say where a model and the robot still differ, before anything is named."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from torchrbd.diagnosis.locate.attack import attack
from torchrbd.diagnosis.locate.intervals import Clock
from torchrbd.diagnosis.locate.maps import leftover_maps
from torchrbd.diagnosis.locate.residual import Leftover
from torchrbd.diagnosis.locate.rows import Rows, read_rows
from torchrbd.diagnosis.locate.search import Part, coefficients, refit, search
from torchrbd.diagnosis.locate.signals import Smooth, smooth
from torchrbd.diagnosis.locate.words import sentence
from torchrbd.diagnosis.results import Curve, LeftoverMap, Location, Region, Unexplained, Where
from torchrbd.inference.data.columns import Candidate
from torchrbd.inference.preparation import Prepared

# A joint is named with a body where the body's torque is this part of the noise, and a recording where the part gains
# this much of what it gains in the best one.
_FELT, _LOUD = 0.5, 0.2


def locate(
    prepared: Prepared, pi: torch.Tensor, terms: Sequence[Candidate] = (), model: str = "rigid_body"
) -> tuple[tuple[Location, ...], tuple[LeftoverMap, ...]]:
    """Locate what the re-fitted rigid body, friction, an offset and terms leave.

    Args:
        prepared: the data; blocks that are held out are not looked at.
        pi: (n_params,) inertial parameters whose torque is the load.
        terms: of the model, beside friction and an offset at every joint.
        model: its name.

    Returns:
        The locations, largest gain first, and maps of the leftover over time, position and velocity.
    """
    rows = read_rows(prepared, pi, terms)
    return locate_rows(rows, model)


def locate_rows(rows: Rows, model: str = "rigid_body") -> tuple[tuple[Location, ...], tuple[LeftoverMap, ...]]:
    """Locate what is left in rows that are already read; see ``locate``."""
    parts, last = search(rows)
    clock = Clock(rows)
    # Sizes are those of a plain fit: one that expects drift leaves levels that mean nothing.
    plain = (np.zeros_like(last.filters), last.scale)
    quiet, found = refit(rows, parts, plain, 0), []
    for part in parts:
        others = [p for p in parts if p is not part]
        raw = refit(rows, others, plain, 0).raw
        found.append(_location(clock, part, refit(rows, others, last.noise, 0), raw, quiet, model))
    return tuple(sorted(found, key=lambda x: -x.gain)), leftover_maps(refit(rows, (), plain, 0), quiet, model)


def nameless(left: Sequence[Location], guessed: Sequence[Unexplained]) -> tuple[Unexplained, ...]:
    """Return what is located in the leftover of the last model as unexplained.

    Args:
        left: locations in that leftover.
        guessed: what a learner without physics predicts there; kept at joints where nothing is located, since it sees
            what depends on several signals at once.
    """
    found = [Unexplained(x.joints, x.depends_on, x.where, max(x.share.values()), x.statement) for x in left]
    located = {j for x in left for j in x.joints}
    return (*found, *(u for u in guessed if not located & set(u.joints)))


def _location(clock: Clock, part: Part, without: Leftover, raw: np.ndarray, quiet: Leftover, model: str) -> Location:
    """Describe a part.

    Args:
        clock: of the rows.
        part: what was found.
        without: what is left beside all other parts.
        raw: the same of a plain fit, (M, n).
        quiet: what is left beside all parts, of a plain fit.
        model: the model's name.
    """
    robot, joints = clock.rows.robot, clock.rows.robot.joint_names
    seen = [j for j in part.joints if len(without.e[j])]
    # What the rest of the model would absorb of a part is not seen, and not counted.
    visible = raw - quiet.raw
    rms = {j: float(np.sqrt(np.nanmean(visible[:, j] ** 2))) for j in seen}
    loudness = {j: rms[j] / max(float(quiet.raw_std[j]), 1e-300) for j in seen}
    prominent = sorted(seen, key=lambda j: -loudness[j])
    felt = [j for j in prominent if loudness[j] > _FELT] or prominent[:1]
    where, depends_on, curve = _where(clock, part, without), (), None
    if part.smooth is not None:
        depends_on = (part.smooth.signal.name,)
        if depends_on != ("t",):
            curve = _curve(smooth(without, part.joints[0], part.smooth.signal))
    elif part.stretch is not None:
        depends_on = ("t",)
    links, hit = (), None
    if part.body is not None:
        links = (robot.body_names[part.body],)
        hit = attack(without, {j: part.columns[j] for j in seen}, part.form, robot.gravity.numpy())
    course = "abrupt" if part.stretch else "slow" if depends_on == ("t",) else ""
    unit = "N" if bool(robot.prismatic[felt[0]]) else "N m"
    names = tuple(joints[j] for j in felt)
    return Location(
        model=model,
        joints=names,
        links=links,
        where=where,
        depends_on=depends_on,
        form=part.form,
        course=course,
        gain=part.gain,
        torque_rms={joints[j]: rms[j] for j in felt},
        share={joints[j]: _share(visible[:, j], raw[:, j]) for j in felt},
        curve=curve,
        attack=hit,
        statement=sentence(names, links, where, depends_on, part.form, course, rms[felt[0]], unit, hit),
    )


def _where(clock: Clock, part: Part, without: Leftover) -> Where:
    """Return recordings, times and region of a part."""
    if part.stretch is not None:
        recording, span = clock.place(part.stretch)
        return Where((recording,) if len(clock.numbers) > 1 else None, None if span is None else (span,))
    region = None
    if part.region is not None and part.smooth is not None:
        signal, v = part.smooth.signal.name, part.smooth.signal.v
        region = (Region(signal, max(part.region.low, float(v.min())), min(part.region.high, float(v.max()))),)
    return Where(_recordings(clock.rows, part, without), None, region)


def _share(visible: np.ndarray, left: np.ndarray) -> float:
    """Return the part of a leftover's power that vanishes with a part."""
    seen = np.isfinite(left)
    before, after = np.var(left[seen]), np.var((left - visible)[seen])
    return float(np.clip(1.0 - after / before, 0.0, 1.0)) if before > 0 else 0.0


def _recordings(rows: Rows, part: Part, without: Leftover) -> tuple[str, ...] | None:
    """Return the recordings in which a part is seen, or None if it is in all of them."""
    seen = [j for j in part.joints if len(without.e[j])]
    _, w = coefficients(without, {j: part.columns[j] for j in seen})
    present = np.unique(rows.recording)
    gain = np.zeros(len(present))
    for j in seen:
        f = without.white(j, part.columns[j] @ w)
        f = f - without.basis[j] @ (without.basis[j].T @ f)
        of = np.searchsorted(present, rows.recording[without.index[j]])
        total = np.bincount(of, without.e[j] * f - 0.5 * f**2, len(present))
        gain += total / np.maximum(np.bincount(of, minlength=len(present)), 1)
    loud = gain > _LOUD * gain.max()
    return None if loud.all() else tuple(rows.recordings[k] for k in present[loud])


def _curve(found: Smooth) -> Curve:
    return Curve(found.signal.name, *(tuple(map(float, x)) for x in (found.knots, found.mean, found.std)))
