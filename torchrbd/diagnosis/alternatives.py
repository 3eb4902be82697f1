"""What else a term could be: every rival in its place is fitted, and judged on left-out blocks."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from torchrbd.diagnosis.rows.gain import Gain, gain
from torchrbd.diagnosis.rows.regression import Fit
from torchrbd.diagnosis.search.grid import freedom, fresh_columns
from torchrbd.diagnosis.search.options import COMPETES, Option, instead, is_plain, judged
from torchrbd.diagnosis.search.partial import in_windows
from torchrbd.diagnosis.search.pruning import plain_instead
from torchrbd.diagnosis.search.select import Search
from torchrbd.diagnosis.search.terms import place, without
from torchrbd.diagnosis.search.unnamed import is_smooth
from torchrbd.likelihood.columns import Candidate
from torchrbd.physics import Site, Window

LARGEST_PROBABILITY, LEAST_PROBABILITY = 0.999, 0.01
# A term of which less than this is left beside another effect is a case of that one, which says no other thing.
CONTAINED = 1e-3
LONGEST = 50.0
# Odds that a name only imitates what is in no list, times its gain: by maximum likelihood over the 316 names of 478
# development cases (docs/concealed_development.md).
IMITATED = 20.0
# Viscous friction, Coulomb friction, even or not, and an offset, at all times, are found on every robot: log of how
# much more often than anything else.
PLAIN = 4.0


@dataclass(frozen=True)
class Rival:
    """Another effect in the place of a finding, and how many times as probable it is."""

    candidate: Candidate
    odds: float


@dataclass(frozen=True)
class Weighed:
    """A term, what it gains over none, how many times as probable none is, or a cause of no name, and its rivals."""

    term: Candidate
    worth: Gain
    none: float
    rivals: tuple[Rival, ...]

    @property
    def nameless(self) -> float:
        """How many times as probable it is that a name imitates what is in no list; plain friction every robot has."""
        if is_plain(self.term) or is_smooth(self.term):
            return 0.0
        return IMITATED / max(self.worth.total, IMITATED)

    @property
    def probability(self) -> float:
        """Of the term, against none, what has no name, and each of its rivals."""
        total = self.none + self.nameless + sum(r.odds for r in self.rivals)
        return min(1.0 / (1.0 + total), LARGEST_PROBABILITY)

    @property
    def unlikely(self) -> bool:
        """Whether it is no finding: others in its place are far likelier. Plain friction stays, every robot has it."""
        named = not is_plain(self.term) and not is_smooth(self.term)
        return named and bool(self.rivals) and self.probability < LEAST_PROBABILITY


def weigh(search: Search, fit: Fit) -> tuple[Weighed, ...]:
    """Compare every term of a fit with none and with others in its place, fitted and with refined shapes.

    Plain friction stands beside a name and its rivals, as in the search; what a name contains of it is a rival too.
    """
    found = []
    beside = search.grid.gains(fit)
    for term in fit.terms:
        others = without(fit.terms, term) if is_plain(term) else plain_instead(search, fit.terms, term)
        rest = instead(fit, others, term)
        own = judged(rest, term)
        contained = [c for c in others if c not in fit.terms and {*c.labels} <= {*term.labels}]
        none = rival_odds(rest.errors, own.errors, fit.rows.counts, 0.0)
        simpler = rival_odds(rest.errors, own.errors, fit.rows.counts, -freedom(rest, term) - PLAIN)
        alike = [Rival(c, simpler) for c in contained]
        for option in _instead(search, rest, term, beside):
            c = option.candidate
            if (c.effect.id, c.site) != (term.effect.id, term.site) and _competes(fit, rest, term, option):
                more = freedom(rest, c) - freedom(rest, term)
                more += PLAIN * (is_plain(term) - is_plain(c))
                alike.append(Rival(c, rival_odds(option.errors, own.errors, fit.rows.counts, more)))
        found.append(Weighed(term, own.worth, none, tuple(alike)))
    return tuple(found)


def _instead(search: Search, rest: Fit, term: Candidate, beside: Mapping[tuple[str, Site], float]) -> list[Option]:
    """Return what may be added to a fit without a term, at all times or at the term's.

    Args:
        search: the search.
        rest: the fit.
        term: that is left out.
        beside: what others gain beside the fit with the term, by name.
    """
    site, always = term.site, search.rivals(rest, beside)
    if site.always:
        return always
    windows = [Window(name) for name in site.recordings or ()] if site.window is None else [site.window]
    at_times = [*search.in_some_recordings(rest), *in_windows(search, rest, windows if len(windows) == 1 else ())]
    return [*always, *(o for o in at_times if place(o.candidate) != place(term))]


def _competes(fit: Fit, rest: Fit, term: Candidate, option: Option) -> bool:
    """Say whether an option explains what a term explains: it gains little beside it, and does not contain it.

    What pushes a link for a while contains an offset of its joint, but is another cause.
    """
    C = fresh_columns(fit, option.candidate)
    if C.shape[1] and judged(fit, option.candidate).worth.total > COMPETES * option.worth.total:
        return False
    if not term.site.always and option.candidate.place != term.place:
        return True
    other = Fit(fit.rows, (*rest.terms, option.candidate))
    return other.share_left(fit.rows.columns(term)[1]) > CONTAINED


def rival_odds(rival: np.ndarray, own: np.ndarray, counts: np.ndarray, freedom: float) -> float:
    """Return how many times as probable a rival is as a term, whichever of them leads.

    Args:
        rival: (B, n) its left-out errors.
        own: (B, n) those of the term.
        counts: (n,) rows of each joint.
        freedom: what the rival is freer, in log-likelihood units.
    """
    lead = gain(rival, own, counts)
    return odds(lead, freedom) if lead.total > 0 else 1.0 / odds(gain(own, rival, counts), -freedom)


def odds(lead: Gain, freedom: float) -> float:
    """Return how many times as probable a model is as another that has a lead over it on left-out blocks.

        o = exp(-F) max(exp(-G), min(exp(-t^2 / 2), exp(-R))),   t = G / std(G)

    with F the cost of what the model is freer than the other. The ratio is that of the likelihoods, but never longer
    than the blocks support: their scatter, or what is left of the lead without the best two of them (R). Correlated
    noise and other physics left out make the likelihood overconfident.
    """
    scatter = min(math.exp(-0.5 * max(lead.t, 0.0) ** 2), math.exp(-max(lead.repeated, 0.0)))
    return math.exp(min(-freedom, LONGEST)) * max(math.exp(min(-lead.total, LONGEST)), scatter)
