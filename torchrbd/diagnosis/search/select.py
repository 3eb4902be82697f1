"""Choose the terms that a model lacks.

Friction is the normal case: viscous and Coulomb friction and an offset stand at every joint from the start, so that
they hide nothing, and go at the end where the data does without them. Between, the best addition is taken, as long as
there is one that the left-out blocks accept; of several that are as good, the simplest. After each, all that was chosen
is chosen again. Where names have ended, smooth functions of single signals may follow, and take the place of a name
that they beat clearly: its law is not the one that acts there.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch

from torchrbd.diagnosis.rows.gain import Gain, gain
from torchrbd.diagnosis.rows.regression import Fit, fitted
from torchrbd.diagnosis.search.grid import Grid, complexity, fresh_columns, refined
from torchrbd.diagnosis.search.unnamed import is_smooth, smooth_candidates
from torchrbd.inference.data.columns import Candidate
from torchrbd.inference.physical.prior import Prior

LEAST_GAIN, LEAST_T, LEAST_REPEATED = 12.5, 2.5, 20.0
CLOSE_STD, CLOSE_GAIN, CLOSE_PART, CLOSE_REPEATED = 2.0, 3.0, 0.003, 6.0
LOAD_CHANGE = 0.01
BEATEN_GAIN, BEATEN_PART, MOST_UNNAMED = 10.0, 0.15, 4
MOST_TERMS, SHORTLIST, SHORT_OF_BEST = 12, 10, 0.5
BACKGROUND = ("viscous_friction", "coulomb_friction", "torque_offset")

Terms = tuple[Candidate, ...]


@dataclass(frozen=True)
class Option:
    """A candidate beside a fit: left-out errors (B, n) with it, and what it gains over the fit without."""

    candidate: Candidate
    errors: np.ndarray
    worth: Gain


def judged(fit: Fit, candidate: Candidate) -> Option:
    """Return a candidate with its left-out errors beside a fit."""
    errors = fit.errors_with(fresh_columns(fit, candidate))
    return Option(candidate, errors, gain(fit.errors, errors, fit.rows.counts))


def accepted(worth: Gain) -> bool:
    """Say whether a gain is enough, and no accident of a few blocks."""
    return worth.total > LEAST_GAIN and (worth.t > LEAST_T or worth.repeated > LEAST_REPEATED)


def clearly_worse(lead: Gain, best: float) -> bool:
    """Say whether a model is worse than the best one, whose gain is ``best``, beyond chance and triviality."""
    return _certain(lead) and lead.total > max(CLOSE_GAIN, CLOSE_PART * best)


def _certain(lead: Gain) -> bool:
    return lead.t > CLOSE_STD or lead.repeated > CLOSE_REPEATED


def plausible(fit: Fit, candidate: Candidate) -> bool:
    """Say whether the physics allows what a candidate's parameters would be beside a fit."""
    rows, columns = fit.rows, fit.rows.samples.columns
    known = {place: k for k, place in enumerate(fit.places)}
    C = fresh_columns(fit, candidate)
    w = fit.addition(C).w
    x, new = fit.coefficients_with(C, w)[rows.X.shape[1] :], iter(w)
    places = [(candidate.place, label) for label in candidate.labels]
    widths = rows.widths(candidate.place, rows.samples.features(candidate))
    values = [(x[known[p]] if p in known else next(new)) * width for p, width in zip(places, widths, strict=True)]
    if candidate.place is not None:
        values[0] += columns.urdf_value(candidate)
    parameters = candidate.effect.parameters(torch.tensor(values, dtype=torch.float64), candidate.shape)
    return candidate.effect.plausible({k: float(v) for k, v in parameters.items()}, columns.scale(candidate.site))


def preferred(fit: Fit, options: Sequence[Option]) -> Option:
    """Return the simplest of the options that are not clearly worse than the best."""
    best = max(options, key=lambda o: o.worth.total)
    counts = fit.rows.counts
    rivals = [o for o in options if not clearly_worse(gain(o.errors, best.errors, counts), best.worth.total)]
    return min(rivals, key=lambda o: (complexity(fit, o.candidate), -o.worth.total))


def with_term(terms: Terms, added: Candidate) -> Terms:
    """Add a term; it takes the place of those whose features it contains."""
    own = set(added.labels)
    return (*(c for c in terms if c.place != added.place or not set(c.labels) <= own), added)


class Search:
    """The search for the terms of one robot's model.

    Args:
        grid: the data, and what may be added.
        prior: of the inertial parameters.
        report: told of the terms after each step.
    """

    def __init__(self, grid: Grid, prior: Prior, report: Callable[[Terms], None] = lambda _: None) -> None:
        self.grid, self.prior, self.report = grid, prior, report
        self._smooth: Grid | None = None
        self.background: Terms = tuple(c for c in grid.candidates if c.effect.id in BACKGROUND)

    def run(self) -> Fit:
        """Return the fit with the chosen terms."""
        fit = self.loaded(fitted(self.grid.samples, self.prior, self.background))
        fit = self.challenged(self.named(fit))
        for _ in range(MOST_UNNAMED):
            smooth = self.smooth(fit)
            if smooth is None:
                break
            fit = fitted(fit.rows.samples, self.prior, (*fit.terms, smooth.candidate), fit.rows.noise)
            fit = self.named(self.settled(fit))
        return self.pruned(fit)

    def named(self, fit: Fit) -> Fit:
        """Add effects as long as one is accepted."""
        visited = {frozenset(_names(fit.terms))}
        for _ in range(MOST_TERMS):
            for option in self.acceptable(fit):
                grown = fitted(fit.rows.samples, self.prior, with_term(fit.terms, option.candidate), fit.rows.noise)
                settled = self.settled(grown)
                if frozenset(_names(settled.terms)) not in visited:
                    break
            else:
                break
            fit = self.loaded(settled)
            visited.add(frozenset(_names(fit.terms)))
            self.report(fit.terms)
        return fit

    def smooth(self, fit: Fit, joint: int | None = None) -> Option | None:
        """Return the smooth function that the leftover of a joint, or of any, follows most; None without one."""
        ranked = [one.candidate for one in self._smooth_grid(fit).screened(fit) if one.score > 0]
        offered = [c for c in ranked if joint in (None, c.place)][:SHORTLIST]
        options = [judged(fit, c) for c in offered]
        return max((o for o in options if accepted(o.worth)), key=lambda o: o.worth.total, default=None)

    def _smooth_grid(self, fit: Fit) -> Grid:
        samples = fit.rows.samples
        if self._smooth is None or self._smooth.samples.columns is not samples.columns:
            self._smooth = Grid(samples, smooth_candidates(samples, samples.seen))
        return self._smooth

    def challenged(self, fit: Fit) -> Fit:
        """Put smooth functions in the place of names that they beat clearly."""
        for term in fit.terms:
            if term in self.background or term.place is None or term not in fit.terms:
                continue
            rest = Fit(fit.rows, self._restored(without(fit.terms, term)))
            own, smooth = judged(rest, term), self.smooth(rest, term.place)
            if smooth is not None:
                lead = gain(own.errors, smooth.errors, fit.rows.counts)
                if _certain(lead) and lead.total > max(BEATEN_GAIN, BEATEN_PART * smooth.worth.total):
                    fit = self.settled(Fit(fit.rows, (*rest.terms, smooth.candidate)))
        return fit

    def loaded(self, fit: Fit) -> Fit:
        """Return a fit whose features see the load that it has found."""
        samples = fit.rows.samples
        pi = samples.columns.pi if samples.columns.pi is not None else fit.rows.prior.reference[: len(fit.pi)]
        change = np.sqrt(np.mean((samples.rigid @ (fit.pi - pi).numpy()) ** 2, axis=1))
        if not (change > LOAD_CHANGE * np.sqrt(np.mean(samples.tau**2, axis=1))).any():
            return fit
        self.grid = Grid(samples.around(fit.pi), self.grid.candidates)
        return fitted(self.grid.samples, self.prior, fit.terms, fit.rows.noise)

    def options(self, fit: Fit) -> list[Option]:
        """Return what may be added to a fit, shapes refined."""
        ranked = [one for one in self.grid.screened(fit) if one.score > 0]
        short = [one for one in ranked if one.score > SHORT_OF_BEST * ranked[0].score][:SHORTLIST]
        found = [refined(fit, one.candidate) for one in short]
        return [judged(fit, c) for c in found if plausible(fit, c)]

    def acceptable(self, fit: Fit) -> list[Option]:
        """Return the additions that are accepted, the one to prefer first."""
        options = [o for o in self.options(fit) if accepted(o.worth)]
        if not options:
            return []
        first = preferred(fit, options)
        return [first, *sorted((o for o in options if o is not first), key=lambda o: -o.worth.total)]

    def settled(self, fit: Fit) -> Fit:
        """Choose each term again beside the others."""
        for term in fit.terms:
            if term in self.background or term not in fit.terms:
                continue
            rest = Fit(fit.rows, self._restored(without(fit.terms, term)))
            if is_smooth(term):
                fit = fit if accepted(judged(rest, term).worth) else rest
                continue
            options = [o for o in (*self.options(rest), judged(rest, refined(rest, term))) if accepted(o.worth)]
            fit = Fit(fit.rows, with_term(rest.terms, preferred(rest, options).candidate)) if options else rest
        return fitted(fit.rows.samples, self.prior, fit.terms, fit.rows.noise)

    def _restored(self, terms: Terms) -> Terms:
        """Return terms with the background that another term had contained."""
        have = {(c.place, label) for c in terms for label in c.labels}
        missing = [c for c in self.background if not {(c.place, label) for label in c.labels} <= have]
        return (*missing, *terms)

    def pruned(self, fit: Fit) -> Fit:
        """Drop terms, one at a time, that the left-out blocks do not accept."""
        while fit.terms:
            rest = {c: Fit(fit.rows, without(fit.terms, c)) for c in fit.terms}
            worth = {c: gain(r.errors, fit.errors, fit.rows.counts) for c, r in rest.items()}
            idle = [c for c in fit.terms if not accepted(worth[c])]
            if not idle:
                break
            fit = rest[min(idle, key=lambda c: worth[c].total)]
        return fit


def without(terms: Terms, left_out: Candidate) -> Terms:
    """Return the other terms."""
    return tuple(c for c in terms if c is not left_out)


def _names(terms: Terms) -> list[tuple[str, object]]:
    return [(c.effect.id, c.site) for c in terms]
