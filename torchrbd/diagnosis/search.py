"""Search for the effects that explain the recordings: hypotheses are added, swapped and dropped by their evidence.

The likeliest hypothesis is added while it is likelier than not, given how rare it is and how many places it has. When
none is left, terms that do not predict left-out blocks are dropped, and from then on a term has to predict them:
evidence of rows grows with their number, and on every machine laws absorb a little of what others lack. The model grows
first, since a true term may not predict better while much physics is missing. Then each term is compared with its
rivals, given all others: it is swapped if a rival is likelier, and dropped if none is needed.
Noise is held, see ``discrepancy``: nothing but coefficients, and amplitudes of curves, is learnt with a hypothesis.
What no law explains is left to curves; those over other joints' states, and further tones, are tried last.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from torchrbd._runtime.deadline import is_over
from torchrbd.dataset.columns import Candidate
from torchrbd.dataset.rows import Rows
from torchrbd.diagnosis.curve_hypotheses import curves, is_curve, is_over_own_signal
from torchrbd.diagnosis.discrepancy import Discrepancy, learn_discrepancy
from torchrbd.diagnosis.evidence import Key, ModelEvidence, key_of, show_bodies
from torchrbd.diagnosis.hypotheses import Hypothesis, again, meet, rows_with_load
from torchrbd.diagnosis.left_out import left_out_evidence
from torchrbd.diagnosis.outcome import SearchOutcome, Term
from torchrbd.diagnosis.posterior import excess_evidence, needless
from torchrbd.diagnosis.screening import screen, screen_lasting
from torchrbd.diagnosis.sharpening import best_shape
from torchrbd.diagnosis.windows import PlaceFilter, anywhere
from torchrbd.effects import Effect, Site, Window
from torchrbd.likelihood.likelihood import Likelihood
from torchrbd.likelihood.widths import trial_widths

MOST_TERMS = 24
# Hypotheses whose shapes are refined at each step, and rivals of a term; sweeps over all terms.
_NEAR, _RIVALS, _SWEEPS = 6, 3, 2
# How often effects are given the load of their own fit, and how many nats that has to be worth.
_LOADS, _SAME = 3, 1.0
# Part that one step is of the work that is left; how many there will be, nobody knows.
_STEP = 1 / 8

Kind = tuple[tuple[str, Site], Window | None]
"""Effect and place of a hypothesis, and its window."""
Drop = Callable[[list[Hypothesis]], list[Hypothesis]]
"""Drops terms of a model."""


def search_effects(
    base: Likelihood,
    effects: Sequence[Effect],
    report: Callable[[float, int], None],
    discrepancy: Discrepancy | None = None,
) -> SearchOutcome:
    """Search among effects, and leave to curves what these do not explain.

    Args:
        base: rigid body and baseline friction.
        effects: what may be there.
        report: called after each step with the part of the work that is done, which rises, and the number of effects
            in the model.
        discrepancy: curves and noise of the same base, if they are known.
    """
    discrepancy = discrepancy or learn_discrepancy(base)
    search = Search(discrepancy.rows, effects, discrepancy, report)
    first = search.rank([])
    search, chosen, last = search.start(first)
    chosen, last = search.improve(chosen, last)
    for _ in range(_LOADS):
        now = None if is_over() else search.with_own_load(chosen)
        if now is None:
            break
        search, chosen = now
        chosen, last = search.improve(chosen, search.rank(chosen))
    chosen = search.with_other_curves(chosen)
    complete = not is_over() and len(chosen) < MOST_TERMS
    fit, terms = search.final(search.terms(chosen))
    fit = fit if terms else base
    return SearchOutcome(
        base, fit, search.rows.without_cache, terms, first, last, len(first), search.discrepancy, complete
    )


def _only_once(chosen: Sequence[Hypothesis], effects: Sequence[Effect]) -> set[tuple[str, Site]]:
    """Return effects and places that a model has and cannot have again: what acts for a time may, and two stops.

    A torque is late once, by a delay or by a lag. A joint has one law of friction: a shape, and what modulates it.
    """
    always = [h for h in chosen if h.candidate.site.always and not h.candidate.effect.several]
    return {(e.id, h.name[1]) for h in always for e in effects if _exclude_each_other(e, h.candidate.effect)}


def _exclude_each_other(one: Effect, other: Effect) -> bool:
    same_part = one.friction_part != "" and one.friction_part == other.friction_part
    return one == other or same_part or (one.shifts_clocks and other.shifts_clocks)


class Search(ModelEvidence):
    """The steps of one search; a model is a list of hypotheses.

    Args:
        rows: that features are built from.
        effects: what may be there.
        discrepancy: curves and noise.
        report: called after each step with the part of the work that is done, and the number of effects in the model.
        done: that part so far.
        rejected: kinds of hypotheses that do not predict left-out blocks, and the evidence of these.
    """

    def __init__(
        self,
        rows: Rows,
        effects: Sequence[Effect],
        discrepancy: Discrepancy,
        report: Callable[[float, int], None] = lambda *_: None,
        done: float = 0.0,
        rejected: Mapping[Kind, float] | None = None,
    ) -> None:
        super().__init__(rows, effects, discrepancy)
        self._report, self._done, self._rejected = report, done, dict(rejected or {})
        # Models and terms for which no rival was likelier, and their rivals.
        self._known_rivals = dict[tuple[Key, Key], list[Hypothesis]]()

    def _advance(self, chosen: Sequence[Hypothesis]) -> None:
        self._done += _STEP * (1.0 - self._done)
        self._report(self._done, sum(not is_curve(h.candidate) for h in chosen))

    def rank(self, chosen: Sequence[Hypothesis], wanted: PlaceFilter = anywhere) -> list[Hypothesis]:
        """Return what is likeliest given a model, with refined shapes, then all others."""
        if is_over():
            return []
        return self._compare(chosen, _NEAR, _only_once(chosen, self.effects), wanted)

    def _likely_places(self, found: Iterable[Hypothesis]) -> PlaceFilter:
        """Return a filter of the effects and places of hypotheses that are likelier than not."""
        likely = {(h.candidate.effect.id, _where_to_look(h.candidate.site)) for h in found if self.odds(h) > 0.0}
        return lambda effect, site: (effect.id, site) in likely

    def _compare(
        self,
        chosen: Sequence[Hypothesis],
        near: int,
        known: Collection[tuple[str, Site]],
        wanted: PlaceFilter,
        *,
        lasting: bool = False,
    ) -> list[Hypothesis]:
        """Return hypotheses given a model, the likeliest first.

        Curves explain much of what a law does. So laws are compared without curves, too, to see which are to be tried;
        not those that act for a time, since curves over the state do not.

        Args:
            chosen: the model.
            near: how many have their shapes refined.
            known: effects and places that are no hypotheses.
            wanted: where to look.
            lasting: whether to look only for what acts all the time.
        """
        present, short, others = {h.candidate for h in chosen}, list[Hypothesis](), list[Hypothesis]()
        for k, given in enumerate(self.with_and_without_curves(chosen)):
            look = screen_lasting if lasting or k else screen
            every = look(given, self.rows, self.effects, wanted)
            new = (h for h in every if h.name not in known and h.candidate not in present)
            found = self.ordered(h.count_elsewhere(chosen) for h in new)
            short += [best_shape(given, self.rows, h) for h in found[:near]]
            others = others or found[near:]
        judged = {_kind(h): h for h in reversed(self.judge(chosen, short)) if h.candidate not in present}
        return self.ordered((*judged.values(), *(h for h in others if _kind(h) not in judged)))

    def reshape(self, rest: Sequence[Hypothesis], h: Hypothesis) -> Hypothesis:
        """Return a term as it is, or at another shape, or window, if that is likelier given all other terms."""
        known = [(given, one) for given in self.with_and_without_curves(rest) if (one := again(given, self.rows, h))]
        return self.judge(rest, [h, *(best_shape(given, self.rows, one) for given, one in known)])[0]

    def start(self, found: list[Hypothesis]) -> tuple[Search, list[Hypothesis], list[Hypothesis]]:
        """Return the search, its model when this first depends on its own load, and what may be added to that.

        Other terms would be compared with features of a load that the model no longer has.
        """
        chosen, found = self._add([], found, self._drop_needless, until=_uses_load)
        own = None if is_over() else self.with_own_load(chosen)
        if own is None:
            return self, chosen, found
        search, chosen = own
        return search, chosen, search.rank(chosen)

    def improve(self, chosen: list[Hypothesis], found: list[Hypothesis]) -> tuple[list[Hypothesis], list[Hypothesis]]:
        """Return the terms of a model, and what else was considered: add, then swap and drop, until nothing changes."""
        chosen, found = self._add(chosen, found, self._drop_needless)
        supported = self._drop_unsupported(chosen)
        if len(supported) < len(chosen):
            supported, found = self._add(supported, self.rank(supported), self._drop_unsupported)
        chosen = supported
        for _ in range(_SWEEPS):
            before = [h.candidate for h in chosen]
            chosen = self._drop_unsupported(self._swap(chosen))
            if is_over() or [h.candidate for h in chosen] == before:
                break
            chosen, found = self._add(chosen, self.rank(chosen), self._drop_unsupported)
        return chosen, found

    def _add(
        self,
        chosen: list[Hypothesis],
        found: list[Hypothesis],
        drop: Drop,
        until: Callable[[list[Hypothesis]], bool] = lambda _: False,
    ) -> tuple[list[Hypothesis], list[Hypothesis]]:
        """Return a model with what is likelier than not, and what was not added.

        After each step only what was likelier than not is found again; when nothing of this is left, all is.

        Args:
            chosen: the model.
            found: all that may be added.
            drop: what drops terms again.
            until: says of a model that nothing more is to be added.
        """
        dropped, all_found = set[Candidate](), True
        while len(chosen) < MOST_TERMS and not is_over() and not until(chosen):
            leaders = self._leaders(h for h in found if h.candidate not in dropped)[: MOST_TERMS - len(chosen)]
            if not leaders and all_found:
                break
            if not leaders:
                found, all_found = self.rank(chosen), True
                continue
            before, offered = chosen, [*chosen, *leaders]
            chosen = drop(offered)
            dropped |= {h.candidate for h in offered} - {h.candidate for h in chosen}
            self._advance(chosen)
            if key_of(chosen) != key_of(before):
                found, all_found = self.rank(chosen, self._likely_places(found)), False
        return chosen, found if all_found else self.rank(chosen)

    def _leaders(self, found: Iterable[Hypothesis]) -> list[Hypothesis]:
        """Return the likeliest hypothesis, and those of other joints: each likelier than not, none meets another."""
        leaders = list[Hypothesis]()
        for h in found:
            if self.odds(h) <= 0.0:
                break
            if _kind(h) not in self._rejected and not any(meet(h.candidate, one.candidate) for one in leaders):
                leaders.append(h)
        return leaders

    def _drop_needless(self, chosen: list[Hypothesis]) -> list[Hypothesis]:
        """Drop terms that are not likelier than not given all others, the least likely first."""
        while chosen:
            odds = [self.odds(h) for h in self.conditional(chosen)]
            k = int(np.argmin(odds))
            if odds[k] > 0.0:
                break
            chosen = without(chosen, k)
        return chosen

    def _drop_unsupported(self, chosen: list[Hypothesis]) -> list[Hypothesis]:
        """Drop terms that are not likelier than not, or do not predict left-out blocks, one at a time.

        Curves have no name, and need not predict these.
        """
        while (chosen := self._drop_needless(chosen)) and not is_over():
            evidence = left_out_evidence(self.fit(chosen), self.rows, [h.candidate for h in chosen])
            laws = {k: one for k, one in enumerate(evidence) if not is_curve(chosen[k].candidate)}
            k = min(laws, key=laws.__getitem__, default=None)
            if k is None or laws[k] > 0.0:
                break
            self._rejected[_kind(chosen[k])] = laws[k]
            chosen = without(chosen, k)
        return chosen

    def _swap(self, chosen: list[Hypothesis]) -> list[Hypothesis]:
        """Return terms, each the likeliest of itself, at its best shape, and its rivals, given all others."""
        for k, h in enumerate(chosen):
            if is_over():
                break
            rest = without(chosen, k)
            if (known := (key_of(rest), key_of([h]))) in self._known_rivals:
                continue
            rivals = self.rivals(rest, h)
            allowed = (one for one in rivals if _kind(one) not in self._rejected)
            own = self.reshape(rest, h)
            best = max((own, *allowed), key=self.odds)
            best = own if best is own else self.choose(rest, own, best)
            if key_of([best]) == key_of([h]):
                self._known_rivals[known] = rivals
            chosen = [*chosen[:k], best, *chosen[k + 1 :]]
            self._advance(chosen)
        return chosen

    def rivals(self, rest: Sequence[Hypothesis], h: Hypothesis) -> list[Hypothesis]:
        """Return what may be in the place of a term: at its joint or on the whole robot, for its time if it has one."""
        place, window = h.candidate.place, h.candidate.site.window
        if (known := self._known_rivals.get((key_of(rest), key_of([h])))) is not None:
            return known

        def wanted(e: Effect, site: Site) -> bool:
            at, other = None if e.whole_robot else site.joint, site.window
            if window is None:
                return place in (None, at)
            here = place is None or at in (None, place)
            return here and (other is None or other.recording == window.recording)

        once = _only_once(rest, self.effects) | {h.name}
        return self._compare(rest, _RIVALS, once, wanted, lasting=window is None)[: 2 * _RIVALS]

    def with_own_load(self, chosen: list[Hypothesis]) -> tuple[Search, list[Hypothesis]] | None:
        """Return the search with the load and friction of its model in all features, if its evidence rises by that."""
        if not _uses_load(chosen):
            return None
        other = self._with(rows_with_load(self.fit(chosen)), self.discrepancy)._with_own_widths(chosen)
        onwards = chosen
        for k, h in enumerate(chosen):
            if h.candidate.effect.uses_load:
                onwards = [*onwards[:k], other.reshape(without(onwards, k), h), *onwards[k + 1 :]]
        return (other, onwards) if other.total(onwards) > self.total(chosen) + _SAME else None

    def _with_own_widths(self, chosen: Sequence[Hypothesis]) -> Search:
        """Return the search with the likeliest widths of friction where a term of a model depends on friction.

        Without such a term, as a delay, friction seems to change its sign over a range of speeds.
        """
        best, width = self, self.discrepancy.fit.hyper.rest_width
        sites = [h.candidate.site for h in chosen if h.candidate.effect.sees_friction]
        for j in sorted({site.joint for site in sites if site.always and site.joint is not None}):
            for one in trial_widths(self.rows)[:, j]:
                widths = np.where(np.arange(len(width)) == j, one, best.discrepancy.fit.hyper.rest_width)
                other = self._with(self.rows.at_widths(widths), self.discrepancy.at_widths(widths))
                best = max(best, other, key=lambda search: search.total(chosen))
        return best

    def _with(self, rows: Rows, discrepancy: Discrepancy) -> Search:
        """Return the search with other features, curves and noise."""
        return Search(rows, self.effects, discrepancy, self._report, self._done, self._rejected)

    def terms(self, chosen: list[Hypothesis]) -> tuple[Term, ...]:
        """Return laws with their rivals, then curves: those that the discrepancy still needs, and others."""
        laws, others = list[Term](), list[Term]()
        for k, h in enumerate(self.conditional(chosen)):
            if is_curve(h.candidate):
                others.append(Term(h, ()))
            else:
                rivals = [] if is_over() else self.rivals(without(chosen, k), h)
                laws.append(Term(h, tuple(map(self._limit_rival, rivals))))
        return (*laws, *(Term(h, ()) for h in self.own_curves(chosen)), *others)

    def _limit_rival(self, h: Hypothesis) -> Hypothesis:
        """Return a hypothesis with no more evidence than left-out blocks gave when they rejected it."""
        excess = excess_evidence(h.log_evidence, self._rejected.get(_kind(h), math.inf))
        return replace(h, log_evidence=h.log_evidence - excess)

    def with_other_curves(self, chosen: list[Hypothesis]) -> list[Hypothesis]:
        """Return a model with the curves over other joints' signals, and tones, that it needs; laws may go then."""
        while len(chosen) < MOST_TERMS and not is_over():
            known = {h.name for h in chosen}
            offered = self.ordered(h for h in curves(self.fit(chosen), self.rows) if h.name not in known)
            others = [h for h in offered if not is_over_own_signal(h.candidate)]
            judged = self.judge(chosen, others[:_RIVALS])
            if not judged or self.odds(judged[0]) <= 0.0:
                break
            after = self._drop_needless([*chosen, judged[0]])
            if judged[0].candidate not in [h.candidate for h in after]:
                break
            chosen = after
            self._advance(chosen)
        return chosen

    def final(self, terms: Sequence[Term]) -> tuple[Likelihood, tuple[Term, ...]]:
        """Return the model with its terms, all that is learnt being learnt with them, and those that it needs then.

        It has no curves over time. A term that its noise explains as well is dropped.
        """
        base = self.discrepancy.fit
        while terms:
            own = [term.own for term in terms]
            fit = show_bodies(base.extended([h.extra(base, self.rows) for h in own]).refit, self.rows, own)
            worth = [replace(h, log_evidence=fit.evidence_for(k) + h.paid) for k, h in enumerate(own)]
            drop = needless(self.odds_together(worth))
            if not drop:
                return fit, tuple(terms)
            terms = [term for k, term in enumerate(terms) if k not in drop]
        return base, ()


def _where_to_look(site: Site) -> Site:
    """Return a site as a filter of places knows it."""
    window = None if site.window is None else Window(site.window.recording)
    return replace(site, window=window, recordings=None if site.recordings is None else ())


def _uses_load(chosen: Iterable[Hypothesis]) -> bool:
    return any(h.candidate.effect.uses_load for h in chosen)


def _kind(h: Hypothesis) -> Kind:
    """Return effect, place and window of a hypothesis, whatever its shape."""
    return h.name, h.candidate.site.window


def without(chosen: Sequence[Hypothesis], k: int) -> list[Hypothesis]:
    """Return a model without its k-th term."""
    return [*chosen[:k], *chosen[k + 1 :]]
