"""What a hypothesis is worth in a model: its log evidence, given the other terms, the curves and the noise.

A model is the machine, hypotheses, and the curves of the discrepancy that these leave needed. Noise is held. Curves
have the amplitudes of greatest evidence, so nothing is integrated over the rows again: see ``additions``.

    score = log p(tau | model) + log p(friction resists) + sum over its curves of their prior log odds
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from torchrbd.dataset.columns import Candidate
from torchrbd.dataset.rows import Rows
from torchrbd.diagnosis.calibration import calibrated
from torchrbd.diagnosis.curve_hypotheses import curvature_directions, is_of_time
from torchrbd.diagnosis.discrepancy import Discrepancy
from torchrbd.diagnosis.hypotheses import Hypothesis, mean_of, prior_std, support
from torchrbd.diagnosis.posterior import log_odds
from torchrbd.effects import Effect
from torchrbd.effects.base import ShowsBodies
from torchrbd.effects.smooth_torque import SmoothTorque
from torchrbd.likelihood.additions import Additions
from torchrbd.likelihood.extra import Extra
from torchrbd.likelihood.gaussian import truncated
from torchrbd.likelihood.likelihood import Likelihood

# Models that are kept.
_KNOWN = 4

Key = tuple[tuple[Candidate, float], ...]


def key_of(chosen: Iterable[Hypothesis]) -> Key:
    """Return what decides what a model is worth: its terms, and how large they are believed to be."""
    return tuple((h.candidate, h.scale) for h in chosen)


class ModelEvidence:
    """The models of a search, lists of hypotheses, and what each hypothesis is worth in one.

    Args:
        rows: that features are built from.
        effects: what may be there.
        discrepancy: curves and noise.
    """

    def __init__(self, rows: Rows, effects: Sequence[Effect], discrepancy: Discrepancy) -> None:
        self.rows, self.effects, self.discrepancy = rows, effects, discrepancy
        # Curves that hypotheses may make needless, and what is paid for each. Those over time are noise and stay.
        lasting_curves = ((k, h) for k, h in enumerate(discrepancy.curves) if not is_of_time(h.candidate))
        self._price = {k: calibrated(h.paid) for k, h in lasting_curves}
        self._basis = [self._directions(h) for h in discrepancy.curves]
        pairs = zip(self._basis, discrepancy.extra, strict=True)
        self._curves = [e if len(b) == e.n else Extra(e.place, b @ e.features, e.std[1:]) for b, e in pairs]
        self._known = dict[Key, tuple[Likelihood, Additions]]()

    def _directions(self, curve: Hypothesis) -> np.ndarray:
        """Return the directions (n, K) of a curve's coefficients.

        Every rotor has inertia: a curve over the acceleration is what this does not explain, if it may be there.
        """
        effect, whole = curve.candidate.effect, np.eye(len(curve.coefficients))
        linear = isinstance(effect, SmoothTorque) and effect.signal == "qdd" and any(e.of_rotor for e in self.effects)
        return curvature_directions(curve) if linear else whole

    def odds(self, h: Hypothesis) -> float:
        """Return the log odds of a hypothesis."""
        return log_odds(h, self.rows)

    def odds_together(self, terms: Sequence[Hypothesis]) -> list[float]:
        """Return the log odds of each term of a model given all others, curves of the discrepancy among them."""
        curves = {h.candidate for h in self.discrepancy.curves}
        present = sum(h.candidate in curves for h in terms)
        prior = self.discrepancy.log_odds(present - 1) if present else 0.0
        return [calibrated(h.log_evidence) + prior if h.candidate in curves else self.odds(h) for h in terms]

    def ordered(self, found: Iterable[Hypothesis]) -> list[Hypothesis]:
        """Return hypotheses, the likeliest first."""
        return sorted(found, key=lambda h: -self.odds(h))

    def fit(self, chosen: Sequence[Hypothesis]) -> Likelihood:
        """Return the model with hypotheses, then the curves, whose amplitudes are learnt with them."""
        return self._model(chosen)[0]

    def _model(self, chosen: Sequence[Hypothesis]) -> tuple[Likelihood, Additions]:
        """Return the model, and the same as components that are added to its machine, all curves among them."""
        if (key := key_of(chosen)) not in self._known:
            base, curves = self.discrepancy.fit, self._curves
            extras = [h.extra(base, self.rows) for h in chosen]
            small, n = self._prune_curves(Additions(base, [*extras, *curves]), len(chosen)), len(chosen)
            kept = [replace(e, std=small.std[small.at(n + k)]) for k, e in enumerate(curves) if small.has(n + k)]
            fit = show_bodies(base.extended([*extras, *kept]).plausible(), self.rows, chosen)
            self._known[key] = fit, self._prune_curves(Additions(fit, [*extras, *curves]), n)
            for old in list(self._known)[:-_KNOWN]:
                del self._known[old]
        return self._known[key]

    def _prune_curves(self, model: Additions, first: int, place: int | None = None) -> Additions:
        """Return a model whose curves have their likeliest amplitudes, without those that are less likely than not.

        Args:
            model: with the curves.
            first: number of the first curve.
            place: the joint whose curves may change. Default: all.
        """
        here = [k for k, e in enumerate(self._curves) if place in (None, e.place)]
        kept = [k for k in here if k in self._price and model.has(first + k)]
        time = [first + k for k in here if k not in self._price]
        present = self._count(model, first)
        while True:
            model = model.likeliest([*time, *(first + k for k in kept)])
            prior = self.discrepancy.log_odds(present - 1) if kept else 0.0
            odds = {k: model.evidence_for(first + k) + self._price[k] + prior for k in kept}
            least = min(kept, key=odds.__getitem__, default=None)
            if least is None or odds[least] > 0.0:
                return model
            model, present = model.without(first + least), present - 1
            kept.remove(least)

    def _count(self, model: Additions, first: int) -> int:
        """Return how many curves a model has that hypotheses may make needless."""
        return sum(model.has(first + k) for k in self._price)

    def _prior(self, model: Additions, first: int) -> float:
        """Return the prior log odds of the curves of a model, against none."""
        paid = sum(price for k, price in self._price.items() if model.has(first + k))
        return paid + sum(map(self.discrepancy.log_odds, range(self._count(model, first))))

    def _score(self, model: Additions, first: int) -> float:
        """Return the log evidence of a model, signs of friction included, plus the prior log odds of its curves."""
        return model.log_evidence + model.resistance + self._prior(model, first)

    def total(self, chosen: Sequence[Hypothesis]) -> float:
        """Return the log evidence of a model's fit plus the prior log odds of its curves."""
        fit, model = self._model(chosen)
        return fit.log_evidence + self._prior(model, len(chosen))

    def choose(self, rest: Sequence[Hypothesis], a: Hypothesis, b: Hypothesis) -> Hypothesis:
        """Return the likelier of two hypotheses, given others, each in its own model.

        Evidence is given bodies around which their prior is expanded. Two hypotheses may need different bodies.
        """

        def own(h: Hypothesis) -> float:
            prior = self.odds(h) - calibrated(h.log_evidence)
            return self.total([*rest, h]) + h.paid + prior

        return max((a, b), key=own)

    def evidence(self, chosen: Sequence[Hypothesis], *offered: Hypothesis) -> list[Hypothesis]:
        """Return hypotheses, each given a model, with coefficients and evidence.

        Signs, physical bounds and free choices count. Curves of its joint have other amplitudes with each hypothesis.
        One that makes a curve needless gets what that costs, by its prior odds.
        """
        fit, without = self._model(chosen)
        first, score = len(chosen), self._score(without, len(chosen))
        every = without.with_([h.extra(fit, self.rows) for h in offered])
        found = list[Hypothesis]()
        for new, h in enumerate(offered, len(without)):
            size, scales = prior_std(fit, self.rows, h.candidate)
            place = h.candidate.place
            others = [k for k in range(len(without), len(every)) if k != new]
            with_it = self._prune_curves(self._around(every.without(*others), first, new, place), first, place)
            scale = max(scales, key=lambda one: with_it.sized({new: one * size}).log_evidence)
            if scale != h.scale:
                h = replace(h, scale=scale)
                with_it = self._prune_curves(with_it.sized({new: scale * size}), first, place)
            found.append(
                self._assess(h.count_elsewhere(chosen), fit, with_it, new, self._score(with_it, first) - score)
            )
        return found

    def _around(self, model: Additions, first: int, k: int, place: int | None) -> Additions:
        """Return a model in which the k-th component and the curves of its joint may change; at all joints, if None."""
        curves = [first + i for i, e in enumerate(self._curves) if e.place == place]
        return model if place is None else model.around([*curves, k])

    def conditional(self, chosen: Sequence[Hypothesis]) -> list[Hypothesis]:
        """Return the terms of a model, each with its evidence given all others."""
        fit, every = self._model(chosen)
        first, found = len(chosen), list[Hypothesis]()
        for k, h in enumerate(chosen):
            # Curves of its joint that it makes needless come back.
            place = h.candidate.place
            model = self._around(every, first, k, place)
            sizes = {first + i: e.std for i, e in enumerate(self._curves) if place in (None, e.place)}
            without = self._prune_curves(model.sized(sizes).without(k), first, place)
            gain = self._score(model, first) - self._score(without, first)
            found.append(self._assess(h.count_elsewhere(chosen), fit, model, k, gain))
        return found

    def _assess(self, h: Hypothesis, fit: Likelihood, model: Additions, k: int, gain: float) -> Hypothesis:
        """Return a hypothesis as the k-th component of a model, which gains so much by it at the size that it has."""
        mean, covariance = model.coefficients(k), model.covariance(k)
        std = np.sqrt(covariance.diagonal())
        signs = truncated(mean, std, h.candidate.effect.prior.positive)
        bounds = signs + support(h, fit, self.rows, mean, covariance, model.friction)
        size, scales = prior_std(fit, self.rows, h.candidate)
        each = np.array([model.sized({k: scale * size}).log_evidence for scale in scales])
        gain += mean_of(each) - model.log_evidence
        return replace(h, log_evidence=float(gain + bounds + h.paid), coefficients=mean, std=std)

    def with_and_without_curves(self, chosen: Sequence[Hypothesis]) -> list[Likelihood]:
        """Return a model, and the same without curves if it has any."""
        fit = self.fit(chosen)
        return [fit] if len(fit.extra) == len(chosen) else [fit, fit.extended(fit.extra[: len(chosen)])]

    def own_curves(self, chosen: Sequence[Hypothesis]) -> list[Hypothesis]:
        """Return the discrepancy's curves that a model needs besides its terms.

        Curves over time are noise: they predict no other time. What drifts is reported from the residual.
        """
        model, n = self._model(chosen)[1], len(chosen)
        return [self._estimate(k, model, n + k) for k in self._price if model.has(n + k)]

    def _estimate(self, curve: int, model: Additions, k: int) -> Hypothesis:
        """Return a curve with amplitude, coefficients and evidence of the k-th component of a model."""
        h, basis = self.discrepancy.curves[curve], self._basis[curve]
        before = h.extra(self.discrepancy.fit, self.rows).std.max() / h.scale
        return replace(
            h,
            log_evidence=model.evidence_for(k),
            coefficients=basis.T @ model.coefficients(k),
            std=np.sqrt(np.einsum("ik,ij,jk->k", basis, model.covariance(k), basis)),
            scale=float(model.std[model.at(k)].max() / before),
        )

    def judge(self, chosen: Sequence[Hypothesis], offered: Iterable[Hypothesis]) -> list[Hypothesis]:
        """Return hypotheses with their evidence given a model, the likeliest first."""
        return self.ordered(self.evidence(chosen, *{h.candidate: h for h in offered}.values()))


def show_bodies(fit: Likelihood, rows: Rows, chosen: Sequence[Hypothesis]) -> Likelihood:
    """Return a model whose bodies act through those of its terms that show them, too."""
    pi = rows.columns.pi
    for k, h in enumerate(chosen):
        effect = h.candidate.effect
        if pi is None or not (isinstance(effect, ShowsBodies) and h.candidate.site.always):
            continue
        C = rows.through_bodies(effect, fit.coefficients(k))
        machine = fit.machine.felt_through(C, pi.numpy())
        fit = fit.of_machine(machine).plausible()
    return fit
