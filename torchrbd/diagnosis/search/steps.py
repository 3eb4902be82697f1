"""The steps of a search: what may be added to a fit, and what is chosen again beside it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np
import torch

from torchrbd.diagnosis.rows.regression import Fit, fitted
from torchrbd.diagnosis.rows.samples import Samples
from torchrbd.diagnosis.rows.weighing import weighed
from torchrbd.diagnosis.search.grid import Grid, Screened, candidates, fresh_columns, refined, refinements
from torchrbd.diagnosis.search.options import (
    BACKGROUND,
    COMPETES,
    LEAST_GAIN,
    SHORTLIST,
    Option,
    instead,
    judged,
    matters,
    plausible,
    preferred,
    takes,
)
from torchrbd.diagnosis.search.recordings import explained, screened_by_recordings, where_larger
from torchrbd.diagnosis.search.terms import Terms, names, place, with_term, without
from torchrbd.diagnosis.search.unnamed import humming, is_smooth, smooth_candidates
from torchrbd.likelihood.columns import Candidate
from torchrbd.likelihood.urdf_prior import Prior
from torchrbd.physics import Effect, Site, effect
from torchrbd.robot import RobotModel

# Change of the load, in parts of a joint's torque, from which on features are built anew.
LOAD_CHANGE = 0.01
# A candidate of whose torque less than this is left beside the model's is the model's.
LEAST_SHARE = 1e-4
# What acts in some recordings explains this part of what is left there: where much is not understood, any two differ.
LEAST_EXPLAINED = 0.25
# Candidates are fitted on left-out blocks if they score this part of the best one that is accepted; without such, of
# the best one or what an effect must gain.
MOST_TERMS, SHORT_OF_BEST = 12, 0.5


class Steps:
    """What a search knows, and the steps that it is made of.

    Args:
        samples: the data.
        effects: what may be added.
        prior: of the inertial parameters.
        report: told of the terms after each step.

    Attributes:
        background: friction and offset of every joint, and the hums that these leave.
        start: the fit with nothing but those.
    """

    def __init__(
        self,
        samples: Samples,
        effects: Iterable[Effect],
        prior: Prior,
        report: Callable[[Terms], None] = lambda _: None,
    ) -> None:
        self.effects, self.prior, self.report = tuple(effects), prior, report
        self._smooth: Grid | None = None
        self._refuted: set[tuple[object, ...]] = set()
        self.background: Terms = tuple(
            samples.columns.candidate(effect(name), Site(joint), {})
            for joint in np.flatnonzero(samples.seen).tolist()
            for name in BACKGROUND
        )
        self.start = weighed(fitted(samples, prior, self.background))
        if hums := tuple(humming(self.start)):
            self.background = (*self.background, *hums)
            self.start = weighed(fitted(self.start.rows.samples, prior, self.background))
        self.grid = Grid(self.start.rows.samples, candidates(samples.columns, self.effects, samples.seen))

    def possible(self, terms: Iterable[Candidate]) -> Terms:
        """Return the terms that have not been refuted."""
        return tuple(c for c in terms if place(c) not in self._refuted)

    def named(self, fit: Fit) -> Fit:
        """Add effects as long as one is accepted, and it leads to a set of effects that was not there before."""
        visited = {frozenset(names(fit.terms))}
        for _ in range(MOST_TERMS):
            for option in self.acceptable(fit):
                grown = fitted(fit.rows.samples, self.prior, with_term(fit.terms, option.candidate), fit.rows.noise)
                settled = self.settled(grown)
                if frozenset(names(settled.terms)) not in visited:
                    break
            else:
                break
            fit = self.loaded(settled)
            if fit is not settled:
                # What follows the load may have other shapes now.
                fit = self.settled(fit)
            self.report(fit.terms)
            if (reached := frozenset(names(fit.terms))) in visited:
                break
            visited.add(reached)
        return fit

    @property
    def robot(self) -> RobotModel:
        """The robot."""
        return self.start.rows.samples.columns.robot

    def smooth(self, fit: Fit, joint: int | None = None) -> Option | None:
        """Return the smooth function that the leftover of a joint, or of any, follows most; None without one."""
        offered = (one for one in self.screened_smooth(fit) if one.score > LEAST_GAIN)
        ranked = [one.candidate for one in offered if joint in (None, one.candidate.place)]
        options = [judged(fit, c) for c in ranked[:SHORTLIST]]
        return max((o for o in options if takes(o)), key=lambda o: o.worth.total, default=None)

    def screened_smooth(self, fit: Fit) -> list[Screened]:
        """Return the functions without a law, scored by what they may gain on rows left out, best first.

        That is less than on the rows seen, by one for each coefficient or so.
        """
        samples = fit.rows.samples
        if self._smooth is None or self._smooth.samples.columns is not samples.columns:
            self._smooth = Grid(samples, smooth_candidates(samples, samples.seen))
        screened = (replace(o, score=o.gain - len(o.candidate.labels)) for o in self._smooth.screened(fit))
        return sorted(screened, key=lambda one: -one.score)

    def loaded(self, fit: Fit) -> Fit:
        """Return a fit whose features see the load and the friction that it has found."""
        samples = fit.rows.samples
        friction = _friction(fit)
        fresh = friction if samples.columns.friction is None else friction - samples.columns.friction
        change = np.sqrt(np.mean(samples.supplied(fit.pi - samples.load_parameters, fresh) ** 2, axis=1))
        if not (change > LOAD_CHANGE * np.sqrt(np.mean(samples.tau**2, axis=1))).any():
            return fit
        self.grid = Grid(samples.around(fit.pi, friction), self.grid.candidates)
        return fitted(self.grid.samples, self.prior, fit.terms, fit.rows.noise)

    def options(self, fit: Fit) -> list[Option]:
        """Return what may be added to a fit, shapes refined."""
        return self.shortlisted(fit, self.grid.screened(fit))

    def rivals(self, rest: Fit, beside: Mapping[tuple[str, Site], float]) -> list[Option]:
        """Return what may take the place of a term at all times, shapes refined.

        What gains as much where the term is explains something else, and is no reason to do without the term.

        Args:
            rest: the fit without the term.
            beside: what candidates gain beside the fit with it, by name.
        """
        screened = self.grid.screened(rest)
        return self.shortlisted(rest, [o for o in screened if beside.get(o.name, 0.0) <= COMPETES * o.gain])

    def shortlisted(self, fit: Fit, screened: Sequence[Screened]) -> list[Option]:
        """Return the best of what was screened, shapes refined, with their left-out errors.

        Best on the rows seen may be what physics forbids or left-out blocks refuse: it keeps no other from the list.
        """
        found: list[Option] = []
        least = min(SHORT_OF_BEST * screened[0].score, LEAST_GAIN) if screened else 0.0
        for one in screened[:SHORTLIST]:
            if one.score <= max(least, 0.0):
                break
            if fit.share_left(fresh_columns(fit, one.candidate)) > LEAST_SHARE:
                allowed = (c for c in refinements(fit, one) if plausible(fit, c) and matters(fit, c))
                if c := next(allowed, None):
                    found.append(judged(fit, c))
                    least = max(least, SHORT_OF_BEST * one.score) if takes(found[-1]) else least
        return found

    def in_some_recordings(self, fit: Fit, clear: Fit | None = None) -> list[Option]:
        """Return effects in those recordings in which they gain most, in a clearer view of the same fit if given."""
        fit = clear or fit
        ranked = screened_by_recordings(self.grid, fit)
        turned = [replace(one, candidate=where_larger(fit, one.candidate)) for one in ranked[:SHORTLIST]]
        options = self.shortlisted(fit, [one for one in turned if self.possible([one.candidate])])
        return [o for o in options if explained(fit, o.candidate) > LEAST_EXPLAINED]

    def acceptable(self, fit: Fit) -> list[Option]:
        """Return the additions that are accepted, the one to prefer first."""
        options = [o for o in self.options(fit) if takes(o)]
        if not options:
            return []
        first = preferred(fit, options)
        return [first, *sorted((o for o in options if o is not first), key=lambda o: -o.worth.total)]

    def settled(self, fit: Fit) -> Fit:
        """Choose each term again beside the others."""
        for term in fit.terms:
            if term in self.background or term not in fit.terms:
                continue
            rest = instead(fit, self.restored(without(fit.terms, term)), term)
            if is_smooth(term) or term.site.window is not None:
                fit = fit if takes(judged(rest, term)) else rest
                continue
            always = term.site.always
            others = self.rivals(rest, self.grid.gains(fit)) if always else self.in_some_recordings(rest)
            again = refined(rest, term)
            own = [judged(rest, again)] if plausible(rest, again) else []
            options = [o for o in (*others, *own) if takes(o)]
            fit = Fit(fit.rows, with_term(rest.terms, preferred(rest, options).candidate)) if options else rest
        return fitted(fit.rows.samples, self.prior, fit.terms, fit.rows.noise)

    def with_background(self, fit: Fit) -> Fit:
        """Return a fit with plain friction and an offset at every joint again."""
        return Fit(fit.rows, self.restored(fit.terms))

    def restored(self, terms: Terms) -> Terms:
        """Return terms with the background that another term had contained."""
        have = {(c.place, label) for c in terms for label in c.labels}
        missing = [c for c in self.background if not {(c.place, label) for label in c.labels} <= have]
        return (*missing, *terms)


def _friction(fit: Fit) -> torch.Tensor:
    """Return the friction (n, 3) of a fit's terms, else of the URDF."""
    columns = fit.rows.samples.columns.of_candidates(fit.terms, None)
    known = columns.reference()
    x = known.clone()
    for term in fit.terms:
        index = columns.of(term)
        x[index] = known[index] + torch.from_numpy(fit.coefficients(term))
    return columns.friction_of(fit.terms, x)
