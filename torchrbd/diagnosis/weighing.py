"""What a hypothesis is worth where all else is learnt with it, and without it.

What is not explained colours the noise, and hides in it: the noise of a fit without an effect makes little of it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from torchrbd.dataset.rows import Rows
from torchrbd.diagnosis.hypotheses import Hypothesis, again, support
from torchrbd.likelihood.gaussian import truncated
from torchrbd.likelihood.likelihood import Likelihood


def with_own_noise(fit: Likelihood, rows: Rows, h: Hypothesis) -> Hypothesis:
    """Return a hypothesis; all that is learnt at its joints is learnt with it.

    Rows are weighted by the scatter of the blocks in the larger model's residual. The priors of both models are
    expanded around their own fits, as bodies and friction that absorb the effect are far from the others. Widths and
    noise of one model may suit the other: each gets the better of both.
    """
    at = h.extra(fit, rows).joints
    one = sized(fit, rows, h, lambda model: model.refit_at(at))
    base, extended = fit.refit_at(at), one.extended
    dispersion, widths = extended.hyper.dispersion, (base.hyper.rest_width, extended.hyper.rest_width)
    with_it, without = [extended], [base.dispersed(dispersion)]
    if not np.allclose(*widths):
        with_it.append(one.with_term.refit_with(widths[0]).dispersed(dispersion))
        without.append(fit.refit_with(widths[1]).dispersed(dispersion))
    return _weighed(one, rows, with_it, without)


def learnt_with(fit: Likelihood, rows: Rows, h: Hypothesis) -> Likelihood:
    """Return the model with a hypothesis, all else learnt with it."""
    extra = h.extra(fit, rows)
    return fit.extended((*fit.extra, extra)).refit_at(extra.joints)


def quick_evidence(fit: Likelihood, rows: Rows, h: Hypothesis) -> Hypothesis:
    """Return a hypothesis with only the noise learnt with it: fast, and some nats off.

    The noise of all joints is learnt, as bodies that absorb an effect make noise at other joints too.
    """
    one = sized(fit, rows, h, lambda model: model.renoised(dispersed=True))
    without = fit.with_new_noise.dispersed(one.extended.hyper.dispersion)
    return _weighed(one, rows, [one.extended], [without])


class Sized(NamedTuple):
    """A hypothesis of its likeliest size.

    Attributes:
        hypothesis: with its size.
        average: what averaging over sizes, shapes and windows adds to the log evidence of the model with it.
        with_term, extended: that model, before and after all else is learnt with it.
    """

    hypothesis: Hypothesis
    average: float
    with_term: Likelihood
    extended: Likelihood


def sized(fit: Likelihood, rows: Rows, h: Hypothesis, learn: Callable[[Likelihood], Likelihood]) -> Sized:
    """Return a hypothesis of the size that is likeliest given what is learnt with it.

    The noise of a fit without it hides it, so that it seems to be small; a prior of that size would keep it small.
    """
    sizes, positive = set[float](), h.candidate.effect.prior.positive
    while True:
        with_term = fit.extended((*fit.extra, h.extra(fit, rows)))
        extended = learn(with_term)
        own, sizes = extended.extended(fit.extra), {*sizes, h.scale}
        # What touches no torque that is measured is worth what it was.
        now = again(own, rows, h) or h
        if now.scale in sizes:
            break
        h = now
    std = np.sqrt(extended.coefficients_covariance(len(fit.extra)).diagonal())
    signs = float(truncated(extended.coefficients(len(fit.extra)), std, positive))
    return Sized(h, now.log_evidence - signs - (extended.log_evidence - own.log_evidence), with_term, extended)


def _weighed(one: Sized, rows: Rows, with_it: Sequence[Likelihood], without: Sequence[Likelihood]) -> Hypothesis:
    """Return a hypothesis with the evidence and coefficients of the likeliest models with it and without."""
    h, noisy, k = one.hypothesis, (with_it[0], without[0]), len(one.extended.extra) - 1
    positive = h.candidate.effect.prior.positive
    best = _likeliest(with_it, noisy)
    mean, covariance = best.coefficients(k), best.coefficients_covariance(k)
    std = np.sqrt(covariance.diagonal())
    bounds = truncated(mean, std, positive) + support(h, best, rows, mean, covariance)
    gain = best.log_evidence - _likeliest(without, noisy).log_evidence
    return replace(h, log_evidence=float(gain + one.average + bounds), coefficients=mean, std=std)


def _likeliest(models: Sequence[Likelihood], noisy: Sequence[Likelihood]) -> Likelihood:
    """Return the model of the greatest log evidence, its noise its own or that of one of several."""
    others = [m.with_noise_of(n) for m in models for n in noisy if n.hyper.noise is not m.hyper.noise]
    return max((*models, *others), key=lambda m: m.log_evidence)
