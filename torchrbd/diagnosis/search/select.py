"""Choose the terms that a model lacks.

Friction is the normal case: viscous and Coulomb friction and an offset stand at every joint from the start, so that
they hide nothing, and go at the end where the data does without them. Between, the best addition is taken, as long as
there is one that the left-out blocks accept; of several that are as good, the simplest. After each, all that was chosen
is chosen again. Where names have ended, smooth functions of single signals may follow, and take the place of a name
that they beat clearly: its law is not the one that acts there.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

import numpy as np
import torch

from torchrbd.diagnosis.locate import stretches
from torchrbd.diagnosis.locate.search import common_noise
from torchrbd.diagnosis.rows.gain import Gain, gain
from torchrbd.diagnosis.rows.regression import Fit, fitted
from torchrbd.diagnosis.rows.samples import Samples
from torchrbd.diagnosis.rows.weighing import weighed
from torchrbd.diagnosis.rows.white_rows import Rows
from torchrbd.diagnosis.rows.whitening import Noise
from torchrbd.diagnosis.search.grid import Grid, Screened, candidates, fresh_columns, refined
from torchrbd.diagnosis.search.options import (
    BACKGROUND,
    Option,
    accepted,
    certain,
    clearly_worse,
    judged,
    least_gain,
    matters,
    plausible,
    preferred,
    takes,
)
from torchrbd.diagnosis.search.recordings import explained, recordings, screened_by_recordings, where_larger
from torchrbd.diagnosis.search.unnamed import is_smooth, smooth_candidates
from torchrbd.inference.data.columns import Candidate
from torchrbd.inference.physical.prior import Prior
from torchrbd.physics import Effect, Site, Window, effect
from torchrbd.robot import RobotModel

# Change of the load, in parts of a joint's torque, from which on features are built anew.
LOAD_CHANGE = 0.01
# A candidate of whose torque less than this is left beside the model's is the model's.
LEAST_SHARE = 1e-4
# A smooth function takes the place of a name if it gains so much more, in units and in parts of its own gain.
BEATEN_GAIN, BEATEN_PART = 10.0, 0.25
MOST_UNNAMED, MOST_WINDOWED, MOST_PARTIAL = 4, 3, 10
# What acts in some recordings explains this part of what is left there: where much is not understood, any two differ.
LEAST_EXPLAINED = 0.25
# Candidates are fitted on left-out blocks if they are among so many, and score this part of the best one.
MOST_TERMS, SHORTLIST, SHORT_OF_BEST = 12, 10, 0.5
UNEVEN, PARTS_OF_UNEVEN = "asymmetric_coulomb_friction", ("coulomb_friction", "torque_offset")

Terms = tuple[Candidate, ...]


class Search:
    """The search for the terms of one robot's model.

    Args:
        samples: the data.
        effects: what may be added.
        prior: of the inertial parameters.
        report: told of the terms after each step.

    Attributes:
        background: friction and offset of every joint.
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
        columns = samples.columns
        self.background: Terms = tuple(
            columns.candidate(effect(name), Site(joint), {})
            for joint in np.flatnonzero(samples.seen).tolist()
            for name in BACKGROUND
        )
        self.start = weighed(fitted(samples, prior, self.background))
        self.grid = Grid(self.start.rows.samples, candidates(columns, self.effects, samples.seen))

    def run(self) -> Fit:
        """Return the fit with the chosen terms."""
        return self._completed(self.loaded(self.start))

    def without(self, fit: Fit, refuted: Sequence[Candidate]) -> Fit:
        """Return a fit that does without some effects at their places, whatever may be chosen instead."""
        self._refuted |= {_place(c) for c in refuted}
        self.grid = Grid(fit.rows.samples, self._possible(self.grid.candidates))
        self.background = self._possible(self.background)
        kept = self._possible(fit.terms)
        return self._completed(fitted(fit.rows.samples, self.prior, self._restored(kept), fit.rows.noise))

    def _possible(self, terms: Iterable[Candidate]) -> Terms:
        return tuple(c for c in terms if _place(c) not in self._refuted)

    def _completed(self, fit: Fit) -> Fit:
        """Add names, then functions without one, and drop what is not needed."""
        fit = self.challenged(self.partial(self.named(fit)))
        for _ in range(MOST_UNNAMED):
            smooth = self.smooth(fit)
            if smooth is None:
                break
            fit = fitted(fit.rows.samples, self.prior, (*fit.terms, smooth.candidate), fit.rows.noise)
            fit = self.named(self.settled(fit))
        if not all(plausible(fit, c) for c in fit.terms):
            fit = self.settled(fit)
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

    def partial(self, fit: Fit) -> Fit:
        """Add what acts in some recordings only, and loads and forces for a time that the leftover shows.

        Of what one recording shows the others say nothing: parts of each are left out, not whole ones.
        """
        started, terms = fit, fit.terms
        if len(recordings(fit.rows.samples)) > 1:
            samples = replace(fit.rows.samples, whole_folds=False)
            fit = Fit(Rows(samples, self.prior, fit.rows.noise), fit.terms)
        for number in range(MOST_PARTIAL):
            clear = self._uncovered(fit)
            windowed = self._windowed(fit, clear) if number < MOST_WINDOWED else []
            options = [o for o in (*windowed, *self.in_some_recordings(fit, clear)) if takes(o)]
            changed = (*fit.terms, preferred(fit, options).candidate) if options else self._not_common(fit)
            if changed is None:
                break
            terms = changed
            fit = self.named(self.settled(fitted(fit.rows.samples, self.prior, terms, fit.rows.noise)))
            self.report(fit.terms)
        return started if terms is started.terms else fit

    def _uncovered(self, fit: Fit) -> Fit:
        """Return a fit with the noise beside what some recordings seem to have.

        A level that one of them has makes the noise look like drift, which hides it.
        """
        samples = fit.rows.samples
        if len(recordings(samples)) == 1:
            return fit
        shared = Fit(Rows(samples, self.prior, common_noise(fit)), fit.terms)
        best = next(iter(screened_by_recordings(self.grid, shared)), None)
        if best is None or best.score <= 0:
            return fit
        beside = Fit(shared.rows, (*fit.terms, best.candidate))
        return Fit(Rows(samples, self.prior, beside.noise()), fit.terms)

    def _not_common(self, fit: Fit) -> Terms | None:
        """Return terms with one for some recordings in the place of one for all that is clearly worse; None without."""
        for term in fit.terms if len(recordings(fit.rows.samples)) > 1 else ():
            if term in self.background or is_smooth(term) or not term.site.always:
                continue
            rest = Fit(fit.rows, self._restored(without(fit.terms, term)))
            own = judged(rest, term)
            for option in self.in_some_recordings(rest):
                lead = gain(own.errors, option.errors, fit.rows.counts)
                if takes(option) and clearly_worse(lead, option.worth.total):
                    return (*rest.terms, option.candidate)
        return None

    def _windowed(self, fit: Fit, clear: Fit) -> list[Option]:
        """Return loads and forces in stretches of time, those that a clearer view of the same fit shows."""
        timed = [e for e in self.effects if e.sites(self.robot, (Window(""),)) and not e.sites(self.robot)]
        if not timed:
            return []
        samples = fit.rows.samples
        offered = candidates(samples.columns, timed, samples.seen, stretches(fit))
        return self._judged(fit, Grid(samples, self._possible(offered)).screened(clear))

    def rivals(self, fit: Fit, term: Candidate) -> list[Option]:
        """Return what may be added to a fit in the place of a term, not the same in other recordings."""
        if term.site.recordings is None:
            return self.options(fit)
        in_some = self.in_some_recordings(fit)
        return [*self.options(fit), *(o for o in in_some if _place(o.candidate) != _place(term))]

    def in_some_recordings(self, fit: Fit, clear: Fit | None = None) -> list[Option]:
        """Return effects in those recordings in which they gain most, in a clearer view of the same fit if given."""
        ranked = screened_by_recordings(self.grid, clear or fit)
        turned = [replace(one, candidate=where_larger(fit, one.candidate)) for one in ranked[:SHORTLIST]]
        options = self._judged(fit, [one for one in turned if self._possible([one.candidate])])
        return [o for o in options if explained(fit, o.candidate) > LEAST_EXPLAINED]

    @property
    def robot(self) -> RobotModel:
        """The robot."""
        return self.start.rows.samples.columns.robot

    def smooth(self, fit: Fit, joint: int | None = None) -> Option | None:
        """Return the smooth function that the leftover of a joint, or of any, follows most; None without one."""
        ranked = [one.candidate for one in self._smooth_grid(fit).screened(fit) if one.score > 0]
        offered = [c for c in ranked if joint in (None, c.place)][:SHORTLIST]
        options = [judged(fit, c) for c in offered]
        return max((o for o in options if takes(o)), key=lambda o: o.worth.total, default=None)

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
            rest = Fit(fit.rows, self._restored(without(fit.terms, term))).renoised()
            own, smooth = judged(rest, term), self.smooth(rest, term.place)
            if smooth is not None:
                lead = gain(own.errors, smooth.errors, fit.rows.counts)
                if certain(lead) and lead.total > max(BEATEN_GAIN, BEATEN_PART * smooth.worth.total):
                    fit = self.settled(Fit(fit.rows, (*rest.terms, smooth.candidate)))
        return fit

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
        return self._judged(fit, self.grid.screened(fit))

    def _judged(self, fit: Fit, screened: Sequence[Screened]) -> list[Option]:
        ranked = [one for one in screened if one.score > 0]
        short = [one for one in ranked if one.score > SHORT_OF_BEST * ranked[0].score][:SHORTLIST]
        told = [one for one in short if fit.share_left(fresh_columns(fit, one.candidate)) > LEAST_SHARE]
        found = [refined(fit, one.candidate) for one in told]
        return [judged(fit, c) for c in found if plausible(fit, c) and matters(fit, c)]

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
            rest = Fit(fit.rows, self._restored(without(fit.terms, term))).renoised()
            if is_smooth(term) or term.site.window is not None:
                fit = fit if takes(judged(rest, term)) else rest
                continue
            others = self.options(rest) if term.site.always else self.in_some_recordings(rest)
            again = refined(rest, term)
            own = [judged(rest, again)] if plausible(rest, again) else []
            options = [o for o in (*others, *own) if takes(o)]
            fit = Fit(fit.rows, with_term(rest.terms, preferred(rest, options).candidate)) if options else rest
        return fitted(fit.rows.samples, self.prior, fit.terms, fit.rows.noise)

    def with_background(self, fit: Fit) -> Fit:
        """Return a fit with plain friction and an offset at every joint again."""
        return Fit(fit.rows, self._restored(fit.terms))

    def _restored(self, terms: Terms) -> Terms:
        """Return terms with the background that another term had contained."""
        have = {(c.place, label) for c in terms for label in c.labels}
        missing = [c for c in self.background if not {(c.place, label) for label in c.labels} <= have]
        return (*missing, *terms)

    def pruned(self, fit: Fit) -> Fit:
        """Drop terms, one at a time, that the left-out blocks do not accept or the physics does not allow.

        Friction at every joint is not asked for what it explains beyond drift: it stays where the errors as they are
        tell it, coloured though they be.
        """
        plain = Rows(fit.rows.samples, self.prior, _uncoloured(fit))
        while fit.terms:
            rest = {c: self._adapted(fit, without(fit.terms, c), c.place) for c in fit.terms}
            worth = {c: _lost(fit, Fit(fit.rows, r).renoised()) for c, r in rest.items()}
            sound = [c for c in fit.terms if self._allowed(c) and plausible(fit, c)]
            idle = [c for c in fit.terms if c not in sound or not accepted(worth[c], least_gain(c))]
            normal = [c for c in idle if c in self.background and c in sound]
            if normal:
                raw = Fit(plain, fit.terms)
                idle = [c for c in idle if c not in normal or not accepted(_lost(raw, Fit(plain, rest[c])))]
            if not idle:
                break
            fit = Fit(fit.rows, rest[min(idle, key=lambda c: worth[c].total)]).renoised()
        return self.joined(fit)

    def _allowed(self, term: Candidate) -> bool:
        """Say whether the user lets a term be found; the background stands in the way of others even if not."""
        sites = self.start.rows.samples.columns.sites
        known = is_smooth(term) or term.effect.id in {e.id for e in self.effects}
        site = replace(term.site, recordings=None)
        return known and site in sites.get(term.effect.id, (site,))

    def _adapted(self, fit: Fit, terms: Terms, place: int | None) -> Terms:
        """Return terms with the shapes that fit best at a joint, now that one is missing there."""
        for term in terms:
            if term.place == place and term.shape and not is_smooth(term):
                changed = refined(Fit(fit.rows, without(terms, term)), term)
                terms = tuple(changed if c is term else c for c in terms)
        return terms

    def joined(self, fit: Fit) -> Fit:
        """Return a fit in which Coulomb friction and an offset smaller than it are friction that is uneven.

        In motion the two say the same; friction that depends on the direction is the more common.
        """
        terms = fit.terms
        for uneven in self.grid.candidates:
            if uneven.effect.id != UNEVEN:
                continue
            here = [c for c in terms if c.place == uneven.place and c.site.always]
            parts = [c for c in here if c.effect.id in PARTS_OF_UNEVEN]
            if len(parts) == len(PARTS_OF_UNEVEN):
                joined = (*(c for c in terms if c not in parts), uneven)
                terms = joined if plausible(Fit(fit.rows, joined), uneven) else terms
        return Fit(fit.rows, terms)


def _friction(fit: Fit) -> torch.Tensor:
    """Return the friction (n, 3) of a fit's terms, else of the URDF."""
    columns = fit.rows.samples.columns.of_candidates(fit.terms, None)
    known = columns.reference()
    x = known.clone()
    for term in fit.terms:
        index = columns.of(term)
        x[index] = known[index] + torch.from_numpy(fit.coefficients(term))
    return columns.friction_of(fit.terms, x)


def _lost(fit: Fit, rest: Fit) -> Gain:
    """Return what a fit gains over another on the same samples."""
    return gain(rest.errors, fit.errors, fit.rows.counts)


def _uncoloured(fit: Fit) -> Noise:
    """Return noise without colour, as large as what a fit leaves."""
    left, weight = fit.leftover(), fit.rows.samples.weight
    scale = np.sqrt(((left * weight) ** 2).sum(1) / np.maximum((weight**2).sum(1), 1e-300))
    return np.zeros_like(fit.rows.noise[0]), np.where(scale > 0, scale, 1.0)


def with_term(terms: Terms, added: Candidate) -> Terms:
    """Add a term; it takes the place of those whose features it contains."""
    own = set(added.labels)
    return (*(c for c in terms if c.place != added.place or not set(c.labels) <= own), added)


def without(terms: Terms, left_out: Candidate) -> Terms:
    """Return the other terms."""
    return tuple(c for c in terms if c is not left_out)


def _names(terms: Terms) -> list[tuple[str, object]]:
    return [(c.effect.id, c.site) for c in terms]


def _place(term: Candidate) -> tuple[object, ...]:
    """Return an effect and its place, whenever it acts, and whether that is in some recordings only."""
    site = term.site
    return term.effect.id, site.joint, site.other, site.body, site.recordings is not None
