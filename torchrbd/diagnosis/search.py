"""Search for the effects that explain the recordings: hypotheses are added, swapped and dropped by evidence alone.

The likeliest hypothesis is added while it is likelier than not, given how rare it is and how many places it has. Then
each is compared with its rivals, given all others: it is swapped if a rival is likelier, and dropped if none is needed.
Curves without a law are hypotheses as well. They are so rare that one replaces a law of as many places only if it has
three nats more. They are tried after the laws, and as rivals of the laws of their joint.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Hashable, Sequence
from dataclasses import replace

import numpy as np
import torch

from torchrbd._runtime.deadline import is_over
from torchrbd.dataset.columns import Candidate
from torchrbd.dataset.rows import Rows
from torchrbd.dataset.shapes import agrees, in_one_cell, varied
from torchrbd.diagnosis.hypotheses import Hypothesis, again, carried, meet
from torchrbd.diagnosis.posterior import log_odds
from torchrbd.diagnosis.residual import curves, curves_at, is_curve, stands_in
from torchrbd.diagnosis.screening import lasting, refined, restarted, screened
from torchrbd.diagnosis.sharpening import at_summit, sharpened
from torchrbd.diagnosis.terms import Explanation, Term
from torchrbd.diagnosis.weighing import learnt_with, quick_evidence, with_own_noise
from torchrbd.effects import Effect, Site
from torchrbd.effects.base import ShowsBodies
from torchrbd.effects.smooth_torque import HUM
from torchrbd.likelihood.likelihood import Likelihood

# Hypotheses whose shapes are refined and whose noise is learnt anew, at each step.
_LEADING = 5
MOST_TERMS = 24
# Laws of the joint that are best with white noise, whose shapes are refined there.
_HIDDEN = 3
# Rivals of a term that are tried given all others, and those of them that are judged; sweeps over all terms.
_RIVALS, _JUDGED, _SWEEPS = 12, 3, 2
# How often the likeliest of several rivals may turn out to be another one.
_TURNS = 2
# How often effects are given the load of their own fit, and how many nats that has to be worth.
_LOADS, _SAME = 3, 1.0
# Part that adding a term is of the work that is left; how many there will be, nobody knows.
_STEP = 1 / 8


def explained(base: Likelihood, effects: Sequence[Effect], report: Callable[[float], None]) -> Explanation:
    """Search among effects, and curves where they do not suffice.

    Args:
        base: rigid body and baseline friction.
        effects: what may be there.
        report: called after each step with the part of the work that is done, which rises.
    """
    search = _Search(carried(base), effects, report)
    first = search.leading(base)
    fit, terms, last = search.swap_and_drop(base, *search.added(base, base, [], [], first))
    for _ in range(_LOADS):
        if is_over():
            break
        now, chosen = search.with_own_load(base, fit, [term.own for term in terms])
        if now is fit:
            break
        rivals, found = [list(term.rivals) for term in terms], search.leading(now, chosen)
        fit, terms, last = search.swap_and_drop(base, *search.added(base, now, chosen, rivals, found))
    return Explanation(base, fit, search.rows, terms, first, last, len(first))


def _alike(h: Hypothesis) -> tuple[Hashable, ...]:
    """Return effect, place and recording, and whether it comes or goes: one hypothesis, whatever its window."""
    window = h.candidate.site.window
    return (*h.name, window and (window.recording, window.one_ended))


def _only_once(chosen: Sequence[Hypothesis], effects: Sequence[Effect]) -> set[tuple[str, Site]]:
    """Return effects and places that a model has and cannot have again: what acts for a time may, and two stops.

    A torque is late once, by a delay or by a lag.
    """
    always = [h for h in chosen if h.candidate.site.always and not h.candidate.effect.several]
    late = [e.id for e in effects if e.shifts_clocks]
    return {(e, h.name[1]) for h in always for e in (late if h.candidate.effect.shifts_clocks else h.name[:1])}


class _Search:
    """Rows, what may be there, and the steps of one search."""

    def __init__(self, rows: Rows, effects: Sequence[Effect], report: Callable[[float], None]) -> None:
        self.rows, self.effects, self.report, self.part = rows, effects, report, 0.0
        # What leads with normal noise where nothing is explained, and what acts for a time: steps look heavy-tailed.
        self.given_normal_noise: list[Hypothesis] | None = None

    def advance(self, share: float) -> None:
        """Report a step that was this share of the work that was left."""
        self.part += share * (1.0 - self.part)
        self.report(self.part)

    def ordered(self, found: Sequence[Hypothesis]) -> list[Hypothesis]:
        """Return hypotheses, the likeliest first."""
        return sorted(found, key=lambda h: -log_odds(h, self.rows))

    def judged(
        self, fit: Likelihood, found: Sequence[Hypothesis], hidden: Sequence[Hypothesis] = ()
    ) -> list[Hypothesis]:
        """Return hypotheses given a fit; for those that lead and their rivals, all that is learnt is learnt anew.

        Their shapes are refined: between the shapes of a grid a law seems to be worth less than a curve, which has
        none.

        The hypotheses of the greatest odds and of the greatest evidence lead. With the noise of the fit without it,
        what is not explained hides much of a law, more of one than of another. So each hypothesis that is likelier than
        not, and acts where a leader does, is its rival.

        Args:
            fit: that they are added to.
            found: what is judged.
            hidden: those that may be hidden by that noise; they lead whatever their evidence seems to be.
        """
        first = {k for k, h in enumerate(found) if h.candidate in [one.candidate for one in hidden]}
        now, done = [quick_evidence(fit, self.rows, h) for h in found], set[int]()
        while now and not is_over():
            odds = np.array([log_odds(h, self.rows) for h in now])
            lead = {int(odds.argmax()), int(np.argmax([h.log_evidence for h in now]))}
            near = [any(meet(h.candidate, now[k].candidate) for k in lead) for h in now]
            lead |= first | set(np.flatnonzero(near & (odds >= 0.0)).tolist())
            if lead <= done:
                break
            for k in lead - done:
                now[k] = self.likeliest(fit, self.shaped(fit, found[k]))
            done |= lead
        return self.side_by_side(fit, now, done)

    def side_by_side(self, fit: Likelihood, now: list[Hypothesis], done: Collection[int]) -> list[Hypothesis]:
        """Return hypotheses; rivals of the likeliest are compared with it given the noise that is learnt with it.

        The weights of rows are learnt with each of them, to a hundredth of their evidence, which may be many nats. A
        hypothesis without evidence in the place of the likeliest, both weighed alike, is no rival; it is present as
        well.
        """
        now = list(now)
        for _ in range(_TURNS if len(done) > 1 else 0):
            first = max(done, key=lambda k: log_odds(now[k], self.rows))
            best = now[first]
            given = learnt_with(fit, self.rows, best).extended(fit.extra)
            level = again(given, self.rows, best)
            rivals = [k for k in done if k != first and meet(now[k].candidate, best.candidate)]
            for k in rivals:
                one = again(given, self.rows, now[k])
                if one is None or level is None or not np.isfinite(now[k].log_evidence):
                    continue
                worth = best.log_evidence + one.log_evidence - level.log_evidence
                if worth > 0.0:
                    now[k] = replace(now[k], log_evidence=worth)
            if max(done, key=lambda k: log_odds(now[k], self.rows)) == first:
                break
        return now

    def sought(self, fit: Likelihood, known: Collection[tuple[str, Site]]) -> list[Hypothesis]:
        """Return laws given a fit, the likeliest first, without those that are known."""
        return self.ordered([h for h in screened(fit, self.rows, self.effects) if h.name not in known])

    def leading(self, fit: Likelihood, chosen: Sequence[Hypothesis] = ()) -> list[Hypothesis]:
        """Return laws given a fit that are not in it, the leading ones with refined shapes and their own noise."""
        if is_over():
            return []
        known = _only_once(chosen, self.effects)
        likely, near, present = self.sought(fit, known), list[Hypothesis](), {h.candidate for h in chosen}
        while likely and len(near) < _LEADING:
            one = refined(fit, self.rows, likely.pop(0))
            near += [] if one.candidate in present else [one]
        if self.given_normal_noise is None:
            plain = fit.with_normal_noise
            others = [] if plain is fit else self.sought(plain, known)
            brief = [h for h in others[_LEADING:] if h.candidate.site.window is not None]
            self.given_normal_noise = [refined(plain, self.rows, h) for h in (*others[:_LEADING], *brief[:_LEADING])]
        seen = {h.candidate for h in near} | present
        others = [again(fit, self.rows, h) for h in self.given_normal_noise if h.name not in known]
        # Where nothing is explained yet, noise has the colour of all that is left out.
        hidden = self.hidden(fit, known, 1 if chosen else _HIDDEN)
        near += [h for h in (*others, *hidden) if h is not None and h.candidate not in seen]
        others = [h for h in likely if h.candidate not in present]
        best = self.ordered((*self.judged(fit, near, () if chosen else hidden[:1]), *others))
        first = {_alike(h): h for h in reversed(best)}
        return [h for h in best if first[_alike(h)] is h]

    def hidden(self, fit: Likelihood, known: Collection[tuple[str, Site]], most: int) -> list[Hypothesis]:
        """Return for each joint the law that is best with white noise: the noise that is learnt has the law's colour.

        The first is the best of all. It is the likeliest of the ``most`` best laws of its joint, at refined shapes.
        Shape and size are those with white noise.
        """
        plain, laws = fit.least_squares, dict[int | None, list[Hypothesis]]()
        for h in self.ordered([h for h in lasting(plain, self.rows, self.effects) if h.name not in known]):
            laws.setdefault(h.candidate.place, []).append(h)
        found = []
        for own in laws.values():
            near = [refined(plain, self.rows, h) for h in own[: 1 if found else most]]
            best = at_summit(plain, self.rows, self.ordered(near)[0])
            one = again(fit, self.rows, best)
            found += [] if one is None else [replace(one, scale=best.scale)]
        return found

    def offered(self, fit: Likelihood, chosen: Sequence[Hypothesis]) -> list[Hypothesis]:
        """Return curves and tones given a fit that a model may have: one for each joint and signal.

        Of those that could absorb friction or inertia, one for each joint, as two of them may cancel.
        """
        known, taken = {h.name for h in chosen}, {h.candidate.joint for h in chosen if stands_in(h.candidate)}
        found = [h for h in curves(fit, self.rows) if h.name not in known]
        return [h for h in found if not (stands_in(h.candidate) and h.candidate.joint in taken)]

    def curves(self, fit: Likelihood, chosen: Sequence[Hypothesis]) -> list[Hypothesis]:
        """Return the likeliest curves and tones given a fit.

        Noise that was learnt without a curve has its colour and hides it; white noise does not.
        """
        found, plain = self.offered(fit, chosen), fit.least_squares
        functions = {h.candidate: h for h in found if h.candidate.effect is not HUM}
        hidden = [one for h in functions.values() if (one := again(plain, self.rows, h)) is not None]
        first = [h.candidate for kind in (list(functions.values()), hidden) for h in self.ordered(kind)[:1]]
        tones = [h for h in found if h.candidate.effect is HUM]
        return self.judged(fit, [*(functions[c] for c in dict.fromkeys(first)), *tones])

    def with_terms(self, base: Likelihood, chosen: Sequence[Hypothesis]) -> Likelihood:
        """Return the model with chosen hypotheses, all else learnt given them."""
        fit = base.extended([h.extra(base, self.rows) for h in chosen]).refit
        for k, h in enumerate(chosen):
            fit = self.felt_through(fit, k, h)
        return fit

    def with_own_load(
        self, base: Likelihood, fit: Likelihood, chosen: list[Hypothesis]
    ) -> tuple[Likelihood, list[Hypothesis]]:
        """Return a model and its terms where effects have its own load and friction, as long as its evidence rises.

        From then on so have all hypotheses of this search.
        """
        for _ in range(_LOADS):
            if not any(h.candidate.effect.uses_load for h in chosen):
                break
            before, self.rows = self.rows, carried(fit)
            onwards = self.reshaped(base, chosen)
            now = self.with_terms(base, onwards)
            if now.log_evidence <= fit.dispersed(now.hyper.dispersion).log_evidence + _SAME:
                self.rows = before
                break
            fit, chosen = now, onwards
        return fit, chosen

    def reshaped(self, base: Likelihood, chosen: Sequence[Hypothesis]) -> list[Hypothesis]:
        """Return hypotheses; those that act through the load get the best shapes given all others."""
        found = list(chosen)
        for k, h in enumerate(found):
            c = h.candidate
            linear = not varied(self.rows.columns, c) and agrees(c, torch.from_numpy(h.coefficients))
            if c.effect.uses_load and not linear:
                others = [*found[:k], *found[k + 1 :]]
                rest = self.with_terms(base, others) if others else base
                found[k] = self.best_shaped(rest, h)
        return found

    def best_shaped(self, fit: Likelihood, h: Hypothesis) -> Hypothesis:
        """Return a hypothesis at the best of the shapes that are found for it, its own among them."""
        ways, own = self.shaped(fit, h), again(fit, self.rows, h)
        if own is not None and not in_one_cell(self.rows.columns, ways[0].candidate, own.candidate):
            ways.append(own)
        return ways[0] if len(ways) == 1 else self.likeliest(fit, ways)

    def likeliest(self, fit: Likelihood, ways: Sequence[Hypothesis]) -> Hypothesis:
        """Return the likeliest of several shapes of a hypothesis, all that is learnt being learnt with each."""
        return max((with_own_noise(fit, self.rows, one) for one in ways), key=lambda one: one.log_evidence)

    def shaped(self, fit: Likelihood, h: Hypothesis) -> list[Hypothesis]:
        """Return a hypothesis at the shapes that steps find from its own, and from independent rows' if apart."""
        own, start = sharpened(fit, self.rows, h), restarted(fit, self.rows, h)
        if start is None or in_one_cell(self.rows.columns, start.candidate, own.candidate):
            return [own]
        return [own, sharpened(fit, self.rows, start)]

    def felt_through(self, fit: Likelihood, k: int, h: Hypothesis) -> Likelihood:
        """Return a model whose bodies act through its k-th term too, if that shows them."""
        pi, effect = self.rows.columns.pi, h.candidate.effect
        if pi is None or not (isinstance(effect, ShowsBodies) and h.candidate.site.always):
            return fit
        C = self.rows.through_bodies(effect, fit.coefficients(k))
        machine = fit.machine.felt_through(C, pi.numpy())
        return Likelihood(machine, fit.hyper, fit.extra).refit

    def added(
        self,
        base: Likelihood,
        fit: Likelihood,
        chosen: list[Hypothesis],
        seen: list[list[Hypothesis]],
        found: list[Hypothesis],
    ) -> tuple[Likelihood, list[Hypothesis], list[list[Hypothesis]], list[Hypothesis]]:
        """Add what is likelier than not, one after the other, and drop what is no longer needed.

        Args:
            base, fit: rigid body with baseline friction, and the model so far.
            chosen, seen: its terms, and what was considered where each of these was added.
            found: what may be added, the likeliest first.

        Returns:
            The model, its terms, what was considered with each, and what was not added.
        """
        seen = list(seen)
        for _ in range(len(chosen), MOST_TERMS):
            if is_over():
                break
            if not found or log_odds(found[0], self.rows) <= 0.0:
                found = self.ordered((*self.curves(fit, chosen), *found))
                if not found or log_odds(found[0], self.rows) <= 0.0:
                    break
            seen.append(found[1:])
            chosen = [*chosen, found[0]]
            self.advance(_STEP)
            fit = fit.extended([*fit.extra, found[0].extra(fit, self.rows)]).refit
            fit = self.felt_through(fit, len(chosen) - 1, found[0])
            if found[0].candidate.effect.uses_load:
                fit, chosen = self.with_own_load(base, fit, chosen)
            fit, chosen, seen = self.needed(base, fit, chosen, seen)
            found = self.leading(fit, chosen)
        return fit, chosen, seen, found

    def needed(
        self, base: Likelihood, fit: Likelihood, chosen: list[Hypothesis], seen: list[list[Hypothesis]]
    ) -> tuple[Likelihood, list[Hypothesis], list[list[Hypothesis]]]:
        """Drop terms that are not likelier than not given the last that was added, the least likely first.

        Of two forces in nearly the same window the second may explain all that the first did.
        """
        while True:
            worth = [replace(h, log_evidence=fit.evidence_for(k) + h.paid) for k, h in enumerate(chosen[:-1])]
            odds = [log_odds(h, self.rows) for h in worth]
            if min(odds, default=1.0) > 0.0:
                return fit, chosen, seen
            k = int(np.argmin(odds))
            chosen, seen = [*chosen[:k], *chosen[k + 1 :]], [*seen[:k], *seen[k + 1 :]]
            fit = self.with_terms(base, chosen)

    def swap_and_drop(
        self,
        base: Likelihood,
        fit: Likelihood,
        chosen: list[Hypothesis],
        seen: list[list[Hypothesis]],
        last: list[Hypothesis],
    ) -> tuple[Likelihood, tuple[Term, ...], list[Hypothesis]]:
        """Judge each term and its rivals given all others; swap and drop until nothing changes.

        Once judged, a term is judged again where others that meet its rows have changed.
        """
        terms: list[Term] = []
        changed: list[Candidate] = []
        for _ in range(_SWEEPS):
            before, terms, changed_before, changed = terms, [], changed, []
            while (k := len(terms)) < len(chosen):
                if is_over():
                    # Given the terms that were there when it was added.
                    terms += [Term(h, tuple(rivals[:_JUDGED])) for h, rivals in zip(chosen[k:], seen[k:], strict=True)]
                    break
                now = chosen[k].candidate
                stays = [t for t in before if t.own.candidate == now and not any(meet(now, c) for c in changed_before)]
                if stays:
                    terms += stays[:1]
                    continue
                term = self._judged_again(base, chosen, k, seen[k])
                # A sweep is half of what is left, in equal steps.
                self.advance(1 / (2 * len(chosen) - k))
                own, best = term.own, term.best(self.rows)
                needless = log_odds(best, self.rows) <= 0.0
                if needless or best is not own:
                    changed += [own.candidate, best.candidate]
                if needless:
                    chosen, seen = [*chosen[:k], *chosen[k + 1 :]], [*seen[:k], *seen[k + 1 :]]
                    continue
                if best is not own and self._needed_with_curve(base, chosen, own, best):
                    chosen, seen = [*chosen, best], [*seen, [own]]
                    term = Term(own, tuple(h for h in term.rivals if h is not best))
                elif best is not own:
                    others = [h for h in (chosen[k], *seen[k]) if _alike(h) != _alike(best)]
                    chosen, seen = [*chosen[:k], best, *chosen[k + 1 :]], [*seen[:k], others, *seen[k + 1 :]]
                    term = Term(best, tuple(self.ordered([h for h in (own, *term.rivals) if h is not best])))
                terms.append(term)
            if not changed:
                return fit, tuple(terms), last
            fit = self.with_terms(base, chosen)
            last = self.leading(fit, chosen)
            if is_over():
                break
        return fit, tuple(terms), last

    def _needed_with_curve(
        self, base: Likelihood, chosen: Sequence[Hypothesis], own: Hypothesis, best: Hypothesis
    ) -> bool:
        """Say whether a law that a curve would replace is needed with it: then the curve is what the law lacks."""
        if not is_curve(best.candidate) or is_curve(own.candidate) or len(chosen) >= MOST_TERMS:
            return False
        others = [h for h in chosen if h.candidate != own.candidate]
        given = self.with_terms(base, [*others, best])
        then = again(given, self.rows, own)
        return then is not None and log_odds(quick_evidence(given, self.rows, then), self.rows) > 0.0

    def _judged_again(self, base: Likelihood, chosen: Sequence[Hypothesis], k: int, seen: Sequence[Hypothesis]) -> Term:
        """Return a term and its rivals given all other terms.

        The likeliest curve of its joint is among them, but none that could absorb friction or inertia.
        """
        others, place = [h for i, h in enumerate(chosen) if i != k], chosen[k].candidate.place
        rest = self.with_terms(base, others) if others else base
        there = _only_once(others, self.effects)
        rivals = [h for h in seen if h.name not in there][:_RIVALS]
        own, *laws = (again(rest, self.rows, h) for h in (chosen[k], *rivals))
        assert own is not None
        likeliest = self.ordered([h for h in laws if h is not None])[:_JUDGED]
        if place is not None:
            known = {h.name for h in (*chosen, *likeliest)}
            functions = [h for h in curves_at(rest, self.rows, [place]) if h.name not in known]
            likeliest += self.ordered([h for h in functions if not stands_in(h.candidate)])[:1]
        own = replace(own, scale=chosen[k].scale)
        own, *rivals = self.judged(rest, (own, *likeliest), [own])
        return Term(own, tuple(self.ordered(rivals)))
