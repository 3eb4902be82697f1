"""What may be added to a model: all candidates screened at once, and the refinement of a shape."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from heapq import nlargest

import numpy as np
from scipy.optimize import minimize_scalar

from torchrbd.diagnosis.rows.regression import Fit
from torchrbd.diagnosis.rows.samples import Samples
from torchrbd.diagnosis.rows.white_rows import Rows
from torchrbd.likelihood.columns import Candidate, Columns
from torchrbd.likelihood.shapes import varied
from torchrbd.physics import Effect, Site, Window

_EVALUATIONS, _SWEEPS, _CLOSE = 10, 2, 0.03
# Along a parameter these parts of the way to the next values on the grid are tried first: what gains may be narrow.
_PARTS = (0.125, 0.5)
# Shapes of several parameters are refined from so many of the grid's, if they gain this part of the best one's.
_STARTS, _NEARLY = 3, 0.5


@dataclass(frozen=True)
class Screened:
    """A candidate beside a fit.

    Attributes:
        candidate: in the shape of the grid with the best score.
        gain: on the rows seen, in log-likelihood units.
        score: the same less the cost of its freedom.
        others: in shapes that gain nearly as much; a better one between may be reached from one of them only.
    """

    candidate: Candidate
    gain: float
    score: float
    others: tuple[Candidate, ...] = ()

    @property
    def name(self) -> tuple[str, Site]:
        """The effect and its site, whatever the shape."""
        return self.candidate.effect.id, self.candidate.site


class Grid:
    """All candidates on one set of samples.

    Args:
        samples: the data.
        candidates: what may be added.
    """

    def __init__(self, samples: Samples, candidates: Iterable[Candidate]) -> None:
        self.samples, self.candidates = samples, tuple(candidates)
        by_place: dict[int | None, list[Candidate]] = {}
        for c in self.candidates:
            by_place.setdefault(c.place, []).append(c)
        self.groups = [Group(place, own, samples) for place, own in by_place.items()]

    def screened(self, fit: Fit) -> list[Screened]:
        """Return the best shape of each effect at each place, best score first."""
        by_name: dict[tuple[str, Site], list[Screened]] = {}
        for group in self.groups:
            for one in group.screened(fit):
                by_name.setdefault(one.name, []).append(one)
        best = [_with_others(shapes) for shapes in by_name.values()]
        return sorted(best, key=lambda one: -one.score)

    def gains(self, fit: Fit) -> dict[tuple[str, Site], float]:
        """Return what each effect gains at each place beside a fit, in its best shape, by name."""
        return {one.name: one.gain for one in self.screened(fit)}


class Group:
    """Candidates that add to the torque of one joint, or of all (None), their columns side by side.

    ``features`` (K, M), or (K, n, M) of all; ``columns`` numbers them by label.
    """

    def __init__(self, place: int | None, candidates: Sequence[Candidate], samples: Samples) -> None:
        self.place, self.candidates = place, candidates
        self.columns: dict[str, int] = {}
        features: list[np.ndarray] = []
        for c in candidates:
            for label, f in zip(c.labels, samples.features(c), strict=True):
                if label not in self.columns and f.any() and np.isfinite(f).all():
                    self.columns[label] = len(features)
                    features.append(f)
        self.features = np.array(features)

    def screened(self, fit: Fit) -> Iterator[Screened]:
        """Yield the candidates that have columns which a fit has not."""
        if not len(self.features):
            return
        rows = fit.rows
        part = slice(None) if self.place is None else rows.parts[self.place]
        C, X = self.widened(rows)[part], fit.X[part]
        S, r = fit.posterior.schur(X.T @ C, C.T @ C + np.eye(C.shape[1])), C.T @ fit.e[part]
        known = {label for place, label in fit.places if place == self.place}
        for c in self.candidates:
            fresh = [self.columns[label] for label in c.labels if label in self.columns and label not in known]
            if fresh:
                own = r[fresh]
                among = S[np.ix_(fresh, fresh)]
                gain = 0.0 if _pushes(c, own) else 0.5 * float(own @ np.linalg.solve(among, own))
                yield Screened(c, gain, gain - freedom(fit, c, among))

    def widened(self, rows: Rows) -> np.ndarray:
        """Return the columns (N, K) as rows see them, whitened and in prior coordinates."""
        C = rows.widened(self.place, self.features)
        for c in self.candidates:
            if std := c.effect.prior.proportions:
                at = [self.columns[label] for label in c.labels if label in self.columns]
                own = [s for label, s in zip(c.labels, std, strict=True) if label in self.columns]
                f = self.features[at]
                free = rows.widths(self.place, f)
                C[:, at] *= rows.widths(self.place, f, own) / np.where(free > 0, free, 1.0)
        return C


def _with_others(shapes: Sequence[Screened]) -> Screened:
    """Return the best of the shapes of an effect at a place, with the others to start from."""
    first, *others = nlargest(_STARTS, shapes, key=lambda one: one.score)
    several = len(first.candidate.shape) > 1
    nearly = [o.candidate for o in others if several and o.gain > _NEARLY * first.gain]
    return replace(first, others=tuple(nearly))


def _pushes(candidate: Candidate, slopes: np.ndarray) -> bool:
    """Say whether the one coefficient of a candidate with a shape would be negative where physics forbids it.

    Its best is zero then: another shape may gain less, but in the right direction.
    """
    one = len(candidate.labels) == len(candidate.effect.prior.positive) == 1
    return one and bool(candidate.shape) and bool(slopes[0] < 0)


def complexity(fit: Fit, candidate: Candidate) -> int:
    """Return the coefficients and shape parameters that a candidate adds to a fit."""
    known = set(fit.places)
    return candidate.effect.complexity - sum((candidate.place, label) in known for label in candidate.labels)


def freedom(fit: Fit, candidate: Candidate, among: np.ndarray | None = None) -> float:
    """Return what the freedom of a candidate costs beside a fit, in log-likelihood units.

    Half the logarithm of the number of rows for each coefficient and shape; less where the prior keeps several
    coefficients in proportion: at most 1/2 log det of their precision.

    Args:
        fit: to which it is added.
        candidate: that is added.
        among: (K, K) precision of its fresh columns beside the fit, if known.
    """
    cost = 0.5 * float(np.log(max(fit.rows.counts.max(), 2)))
    if not candidate.effect.prior.proportions:
        return cost * complexity(fit, candidate)
    among = fit.precision(fresh_columns(fit, candidate)) if among is None else among
    return float(0.5 * np.minimum(np.log(np.linalg.eigvalsh(among)), 2 * cost).sum())


def candidates(
    columns: Columns, effects: Iterable[Effect], measured: Sequence[bool], windows: Sequence[Window] = ()
) -> Iterator[Candidate]:
    """Yield effects at all their places with all shapes of their grids.

    Args:
        columns: of the robot.
        effects: to look for.
        measured: (n,) joints whose torque is known.
        windows: stretches of time in which effects may act.
    """
    for effect in effects:
        for site in columns.sites.get(effect.id, effect.sites(columns.robot, windows)):
            if effect.whole_robot or measured[site.joint or 0]:
                for shape in effect.shapes(columns.scale(site)):
                    yield columns.candidate(effect, site, shape)


def fresh_columns(fit: Fit, candidate: Candidate) -> np.ndarray:
    """Return the columns (N, K) that a candidate has and a fit has not."""
    places, C = fit.rows.columns(candidate)
    known = set(fit.places)
    return C[:, [k for k, place in enumerate(places) if place not in known]]


def refined(fit: Fit, candidate: Candidate) -> Candidate:
    """Return a candidate with the shape, between the neighbours on its grid, that gains most beside a fit."""
    grid = varied(fit.rows.samples.columns, candidate)
    for _ in range(_SWEEPS if len(grid) > 1 else 1):
        for name, axis in grid.items():
            candidate = _along(fit, candidate, name, axis.limits(candidate.shape[name]))
    return candidate


def refinements(fit: Fit, one: Screened) -> list[Candidate]:
    """Return what was screened with its shapes refined, what gains most first."""
    found = [refined(fit, c) for c in (one.candidate, *one.others)]
    return sorted(found, key=lambda c: -_gain(fit, c)) if len(found) > 1 else found


def _along(fit: Fit, candidate: Candidate, name: str, bounds: tuple[float, float]) -> Candidate:
    columns = fit.rows.samples.columns

    def at(value: float) -> Candidate:
        return columns.candidate(candidate.effect, candidate.site, {**candidate.shape, name: float(value)})

    def loss(value: float) -> float:
        return -_gain(fit, at(value))

    now = candidate.shape[name]
    losses = {value: loss(value) for value in (now, *(now + part * (end - now) for end in bounds for part in _PARTS))}
    best = min(losses, key=lambda value: losses[value])
    low = max((value for value in (*losses, *bounds) if value < best), default=best)
    high = min((value for value in (*losses, *bounds) if value > best), default=best)
    options = {"xatol": _CLOSE * (high - low), "maxiter": _EVALUATIONS}
    found = minimize_scalar(loss, bounds=(low, high), method="bounded", options=options)
    return at(found.x if found.fun < losses[best] else best)  # pyright: ignore[reportAttributeAccessIssue]


def _gain(fit: Fit, candidate: Candidate) -> float:
    """Return what a candidate gains beside a fit on the rows seen; nothing of it is remembered."""
    known = set(fit.places)
    fresh = [k for k, label in enumerate(candidate.labels) if (candidate.place, label) not in known]
    features = fit.rows.samples.evaluated(candidate)[fresh]
    if not fresh or not np.isfinite(features).all():
        return 0.0
    return fit.addition(fit.rows.widened(candidate.place, features))[0]
