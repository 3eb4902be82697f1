"""Every effect at every place, given a likelihood, also at shapes between those of the grid."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from torchrbd.dataset.columns import Candidate
from torchrbd.dataset.rows import Rows
from torchrbd.dataset.shapes import varied
from torchrbd.diagnosis.hypotheses import Hypothesis, agree_shape, average_each, hypothesis_of, mean_of
from torchrbd.diagnosis.windows import PlaceFilter, anywhere, in_recordings, in_windows, place_window
from torchrbd.effects import Effect, Site
from torchrbd.likelihood.likelihood import Likelihood

# Points between a shape's neighbours on the grid.
_FINE = 9


def screen(fit: Likelihood, rows: Rows, effects: Sequence[Effect], wanted: PlaceFilter = anywhere) -> list[Hypothesis]:
    """Return every effect at every place given a fit, for a time and in some recordings too, greatest evidence first.

    Args:
        fit: the base.
        rows: its rows, whose signals carry its load and friction.
        effects: what may be there.
        wanted: where to look.
    """
    found: list[Hypothesis | None] = [*screen_lasting(fit, rows, effects, wanted)]
    found += in_windows(fit, rows, [e for e in effects if not e.is_ubiquitous], wanted)
    # Friction of some recordings only is not the machine's.
    found += (h for e in effects for h in in_recordings(fit, rows, e, wanted))
    return sorted((h for h in found if h is not None), key=lambda h: -h.log_evidence)


def screen_lasting(
    fit: Likelihood, rows: Rows, effects: Sequence[Effect], wanted: PlaceFilter = anywhere
) -> list[Hypothesis]:
    """Return every effect that acts all the time, at every place where it is wanted, given a fit."""
    columns, grids = rows.columns, dict[int | None, list[list[Candidate]]]()
    for e in (e for e in effects if not e.is_ubiquitous):
        for site in e.sites(columns.robot):
            if _may_be(e, site, rows) and wanted(e, site):
                grid = [columns.candidate(e, site, shape) for shape in e.shapes(columns.scale(site))]
                grids.setdefault(None if e.whole_robot else site.joint, []).append(grid)
    return [h for several in grids.values() for h in average_each(fit, rows, several) if h is not None]


def refine_shape(fit: Likelihood, rows: Rows, h: Hypothesis) -> Hypothesis:
    """Return a hypothesis whose shape, or window, lies between those of the grid, averaged over the finer cell."""
    if h.candidate.site.window is not None:
        return place_window(fit, rows, h)
    columns, at = rows.columns, hypothesis_of(fit, rows, h.candidate)
    if at is None:
        return h
    # What the average has of this shape is replaced by that of the cell around it, which axes share as factors.
    rest = _less(h.log_evidence, at.log_evidence - math.log(h.tried))
    at = _or_agreeing(fit, rows, at)
    cell = at.log_evidence
    for name, axis in varied(columns, h.candidate).items():
        now = at.candidate
        values = np.union1d(np.linspace(*axis.limits(now.shape[name]), _FINE), now.shape[name])
        near = [columns.candidate(now.effect, now.site, {**now.shape, name: float(v)}) for v in values]
        found = _hypotheses_of(fit, rows, near)
        if not found:
            continue
        cell += mean_of(np.array([one.log_evidence for one in found])) - at.log_evidence
        at = max(found, key=lambda one: one.log_evidence)
    mean = float(np.logaddexp(rest, cell - math.log(h.tried)))
    return replace(at, log_evidence=mean, tried=h.tried, paid=mean - at.log_evidence)


def _or_agreeing(fit: Likelihood, rows: Rows, one: Hypothesis) -> Hypothesis:
    """Return the likeliest of a candidate and those of its grid whose shapes agree with their coefficients."""
    c, found = one.candidate, [one]
    if c.effect.follows:
        grid = [
            rows.columns.candidate(c.effect, c.site, shape) for shape in c.effect.shapes(rows.columns.scale(c.site))
        ]
        found += [agree_shape(fit, rows, other, plausible=False) for other in _hypotheses_of(fit, rows, [c, *grid])]
    return max(found, key=lambda each: each.log_evidence)


def start_each_kind(fit: Likelihood, rows: Rows, h: Hypothesis) -> list[Hypothesis]:
    """Return a hypothesis, then one of each other kind, such as the side of a stop: at its shape, and at the best one.

    Kinds have no values between them, and each has shapes of its own: refining never leads from one to another.
    """
    columns, (effect, site, now) = rows.columns, (h.candidate.effect, h.candidate.site, h.candidate.shape)
    grid = effect.shapes(columns.scale(site)) if effect.kinds else ()
    kinds = {tuple(shape[name] for name in effect.kinds) for shape in grid} - {
        tuple(now[name] for name in effect.kinds)
    }
    found = [h]
    for kind in sorted(kinds):
        own = dict(zip(effect.kinds, kind, strict=True))
        moved = _hypotheses_of(fit, rows, [columns.candidate(effect, site, {**now, **own})])
        like = [columns.candidate(effect, site, shape) for shape in grid if own.items() <= shape.items()]
        best = sorted(_hypotheses_of(fit, rows, like), key=lambda one: -one.log_evidence)[:1]
        found += (replace(h, candidate=one.candidate) for one in (*moved, *best))
    return found


def _less(total: float, part: float) -> float:
    """Return log(exp(total) - exp(part)), the part being no more than the total but for rounding."""
    return total + math.log(-math.expm1(part - total)) if part < total else -math.inf


def _hypotheses_of(fit: Likelihood, rows: Rows, candidates: Sequence[Candidate]) -> list[Hypothesis]:
    """Return the evidence of candidates one by one, without those that cannot be evaluated."""
    return [one for one in average_each(fit, rows, [[c] for c in candidates]) if one is not None]


def _may_be(e: Effect, site: Site, rows: Rows) -> bool:
    """Say whether an effect at a site is a hypothesis: torques are known there, and the machine has it not."""
    if is_clocks(e, site, rows):
        return False
    return site.joint is None or e.whole_robot or bool(rows.seen[site.joint])


def is_clocks(e: Effect, site: Site, rows: Rows) -> bool:
    """Say whether an effect at a site is what the offset of the clocks is, which every model has."""
    return e.shifts_clocks and (site.joint is None or rows.n_dof == 1)
