"""A hypothesis: an effect at a place, and its evidence given a likelihood, averaged over its free choices.

    log B = log mean_(shape, window, size) p(tau | base, effect) / p(tau | base)

The mean pays for the number of shapes and windows of time that were tried.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from torchrbd.dataset.columns import Candidate
from torchrbd.dataset.rows import Rows
from torchrbd.effects import Site
from torchrbd.effects.base import DIRECTION, SPEED
from torchrbd.likelihood.coefficient_prior import coefficient_std
from torchrbd.likelihood.extra import Extra
from torchrbd.likelihood.gaussian import added
from torchrbd.likelihood.likelihood import Likelihood

# Columns that baseline friction has too.
SHARED = (SPEED, DIRECTION)
# Numbers of the features whose rows are read together.
_AT_ONCE = 4_000_000
# Draws that estimate how much of a distribution physics allows, and the part of variances that is rounding.
_DRAWS, _ROUNDING = 256, 1e-12
# The gain [nats] that is worth another step of a shape, and how many there are towards one that agrees.
LEAST_GAIN, _MOST_STEPS = 0.1, 10


@dataclass(frozen=True)
class Hypothesis:
    """An effect at a place, and what the data say for it.

    Attributes:
        candidate: the effect with the shape, or window, of the greatest evidence.
        log_evidence: against the base, in nats.
        coefficients, std: (K,) posterior of its coefficients.
        scale: multiple of their prior that has the greatest evidence.
        tried: shapes, or windows, that were averaged over.
        paid: what averaging over them has cost: log evidence less that of the candidate alone.
        elsewhere: at how many other joints the model has the effect that it is compared in, if it is one of drives.
    """

    candidate: Candidate
    log_evidence: float
    coefficients: np.ndarray
    std: np.ndarray
    scale: float
    tried: int
    paid: float = 0.0
    elsewhere: int = 0

    @property
    def name(self) -> tuple[str, Site]:
        """Effect and place, whatever its window."""
        return self.candidate.effect.id, replace(self.candidate.site, window=None)

    def count_elsewhere(self, others: Iterable[Hypothesis]) -> Hypothesis:
        """Return the hypothesis with the number of other joints at which a model of others has its effect."""
        effect, own = self.candidate.effect, self.candidate.site.joint
        joints = {h.candidate.site.joint for h in others if h.candidate.effect == effect} if effect.of_drives else set()
        return replace(self, elsewhere=len(joints - {own, None}))

    def extra(self, fit: Likelihood, rows: Rows) -> Extra:
        """Return its columns, as a model takes them."""
        std, _ = prior_std(fit, rows, self.candidate)
        return Extra(self.candidate.place, rows.features(self.candidate), std * self.scale)


def meet(a: Candidate, b: Candidate) -> bool:
    """Say whether two terms act on the torque of one joint."""
    return a.place is None or b.place is None or a.place == b.place


def rows_with_load(fit: Likelihood) -> Rows:
    """Return the rows whose signals carry the load and friction of a fit."""
    own = fit.around_its_fit(alone=True)
    return fit.machine.rows.around(own.pi, own.friction, own.rest_width)


def hypothesis_of(fit: Likelihood, rows: Rows, candidate: Candidate) -> Hypothesis | None:
    """Return the evidence of one candidate whose shape, or window, is known."""
    return average_over_shapes(fit, rows, [candidate])


def agree_shape(fit: Likelihood, rows: Rows, one: Hypothesis, *, plausible: bool = True) -> Hypothesis:
    """Return a candidate's evidence with the shape that agrees with its coefficients, while that is likelier.

    Args:
        fit: the evidence is conditional on it.
        rows: its rows.
        one: the candidate.
        plausible: go on, likelier or not, as long as physics does not allow it.
    """
    for _ in range(_MOST_STEPS if one.candidate.effect.follows else 0):
        c = one.candidate
        shape = c.effect.agreeing(torch.from_numpy(one.coefficients), c.shape)
        then = hypothesis_of(fit, rows, rows.columns.candidate(c.effect, c.site, shape))
        must = plausible and not _allowed(one, fit.friction, rows, one.coefficients[None])
        if then is None or (then.log_evidence < one.log_evidence + LEAST_GAIN and not must):
            break
        one = then
    return one


def prior_std(fit: Likelihood, rows: Rows, candidate: Candidate) -> tuple[np.ndarray, tuple[float, ...]]:
    """Return how large coefficients are believed to be, (K,) and multiples, whatever the time in which they act."""
    if not (candidate.site.always or candidate.effect.of_each_recording):
        at = replace(candidate.site, window=None, recordings=None)
        candidate = rows.columns.candidate(candidate.effect, at, candidate.shape)
    return coefficient_std(candidate, rows.rms(candidate), fit.machine.torque_rms)


def average_over_shapes(fit: Likelihood, rows: Rows, candidates: Sequence[Candidate]) -> Hypothesis | None:
    """Return the evidence of an effect at a place, averaged over its shapes and sizes; None if no torque feels it."""
    return average_each(fit, rows, [candidates])[0]


def average_each(fit: Likelihood, rows: Rows, effects: Sequence[Sequence[Candidate]]) -> list[Hypothesis | None]:
    """Return the same for several effects at one place, given the candidates of each; their rows are read together."""
    finite = [[c for c in candidates if np.isfinite(rows.rms(c)).all()] for candidates in effects]
    found: dict[Candidate, tuple[np.ndarray, np.ndarray]] = {}
    for K in {len(c.labels) for several in finite for c in several}:
        alike = list({c: None for several in finite for c in several if len(c.labels) == K})
        step = max(1, _AT_ONCE // max(1, rows.features(alike[0]).size))
        for some in (alike[k : k + step] for k in range(0, len(alike), step)):
            every = fit.precisions_and_scores(some[0].place, np.stack([rows.features(c) for c in some]))
            found |= dict(zip(some, zip(*every, strict=True), strict=True))
    return [_average(fit, rows, several, [found[c] for c in several]) for several in finite]


def _average(
    fit: Likelihood, rows: Rows, known: Sequence[Candidate], moments: Sequence[tuple[np.ndarray, np.ndarray]]
) -> Hypothesis | None:
    """Average over the shapes and sizes of an effect, given precision (K, K) and score (K,) of each shape."""
    felt = [(c, S, r) for c, (S, r) in zip(known, moments, strict=True) if S.any()]
    if not felt:
        return None
    parts, S, r = zip(*felt, strict=True)
    sizes = [prior_std(fit, rows, c) for c in parts]
    scales = np.array(sizes[0][1])
    std = np.stack([s for s, _ in sizes])[:, None] * scales[:, None]
    found = added(np.stack(S)[:, None], np.stack(r)[:, None], std, parts[0].effect.prior.positive)
    shape, size = np.unravel_index(int(found.log_evidence.argmax()), found.log_evidence.shape)
    best, mean = (shape, size), mean_of(found.log_evidence)
    paid = mean - mean_of(found.log_evidence[shape])
    return Hypothesis(parts[shape], mean, found.mean[best], found.std[best], float(scales[size]), len(parts), paid)


def again(fit: Likelihood, rows: Rows, h: Hypothesis) -> Hypothesis | None:
    """Return a hypothesis given another fit, with its shape, window and the evidence that these have cost."""
    one = hypothesis_of(fit, rows, h.candidate)
    return None if one is None else replace(one, log_evidence=one.log_evidence + h.paid, tried=h.tried, paid=h.paid)


def support(
    h: Hypothesis, fit: Likelihood, rows: Rows, mean: np.ndarray, covariance: np.ndarray, friction: np.ndarray
) -> float:
    """Return the evidence for physical bounds: log of the share of the posterior within them, over that of the prior.

    The prior of an effect's coefficients is Gaussian, truncated to parameters that are plausible; signs that
    coefficients must have count already.

    Args:
        h: the hypothesis.
        fit: the evidence is conditional on it.
        rows: its rows.
        mean, covariance: (K,) and (K, K), posterior of its coefficients.
        friction: (n, 3), what the machine's own friction is then.
    """
    rng, std = np.random.default_rng(0), prior_std(fit, rows, h.candidate)[0] * h.scale
    root = np.linalg.cholesky(covariance + _ROUNDING * np.diag(covariance.diagonal() + 1e-300))
    unit = rng.standard_normal((_DRAWS, len(mean)))
    after = _allowed(h, friction, rows, mean + unit @ root.T)
    before = _allowed(h, friction, rows, unit * std)
    if not before:
        # Where no draw is allowed, the shape may be what physics does not allow.
        return -math.inf if h.candidate.shape and not after else 0.0
    return math.log(after / before) if after else -math.inf


def _allowed(h: Hypothesis, friction: np.ndarray, rows: Rows, draws: np.ndarray) -> float:
    """Return the share of draws (D, K), of those whose signs are right, that physics allows."""
    c, positive = h.candidate, list(h.candidate.effect.prior.positive)
    draws = draws[(draws[:, positive] >= 0).all(1)]
    if not len(draws):
        return 1.0
    scale = rows.columns.scale(c.site)
    own = whole(c, draws, friction)
    parameters = c.effect.parameters(torch.from_numpy(own.T), c.shape)
    values = {name: np.broadcast_to(v.detach().numpy(), len(draws)) for name, v in parameters.items()}
    return float(
        np.mean([c.effect.plausible({n: float(v[k]) for n, v in values.items()}, scale) for k in range(len(own))])
    )


def whole(candidate: Candidate, coefficients: np.ndarray, friction: np.ndarray) -> np.ndarray:
    """Return coefficients (..., K) with what the machine's own friction (n, 3) has of the same columns."""
    if candidate.site.joint is None:
        return coefficients
    viscous, plus, minus = friction[candidate.site.joint]
    own = {SPEED: viscous, DIRECTION: 0.5 * (plus + minus)}
    return coefficients + [own[label] if label in SHARED else 0.0 for label in candidate.labels]


def mean_of(log_evidence: np.ndarray) -> float:
    """Return the log of the mean evidence of alternatives that are equally likely."""
    most = float(log_evidence.max())
    if not math.isfinite(most):
        return most
    return most + math.log(float(np.exp(log_evidence - most).mean()))
