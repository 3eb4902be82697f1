"""What a hypothesis is worth where all else is learnt with it, and without it.

What is not explained colours the noise, and hides in it: the noise of a fit without an effect makes little of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from torchrbd.diagnosis.hypotheses import Hypothesis, support
from torchrbd.likelihood.gaussian import truncated
from torchrbd.likelihood.likelihood import Likelihood
from torchrbd.likelihood.rows import Rows


def with_own_noise(fit: Likelihood, rows: Rows, h: Hypothesis) -> Hypothesis:
    """Return a hypothesis with all that is learnt at its joints learnt beside it.

    Rows count by the scatter of the blocks that the larger model leaves. The priors of both are expanded around their
    own fits: bodies and friction that stood in for the effect lie far off. Widths and noise that suit the one may suit
    the other: each has the better of both.
    """
    extra = h.extra(fit, rows)
    beside, at = fit.extended((*fit.extra, extra)), extra.joints
    base, extended = fit.settled_at(at), beside.settled_at(at)
    dispersion, widths = extended.hyper.dispersion, (base.hyper.rest_width, extended.hyper.rest_width)
    with_it, without = [extended], [base.dispersed(dispersion)]
    if not np.allclose(*widths):
        with_it.append(beside.settled_with(widths[0]).dispersed(dispersion))
        without.append(fit.settled_with(widths[1]).dispersed(dispersion))
    return _weighed(fit, rows, h, beside, with_it, without)


def learnt_with(fit: Likelihood, rows: Rows, h: Hypothesis) -> Likelihood:
    """Return the model with a hypothesis, and all that is learnt learnt beside it."""
    extra = h.extra(fit, rows)
    return fit.extended((*fit.extra, extra)).settled_at(extra.joints)


def at_a_glance(fit: Likelihood, rows: Rows, h: Hypothesis) -> Hypothesis:
    """Return a hypothesis with the noise learnt beside it, and nothing else: some nats off, but soon.

    That of all joints is: what bodies do in the place of an effect is noise at others too.
    """
    extra = h.extra(fit, rows)
    beside = fit.extended((*fit.extra, extra))
    extended = beside.renoised(dispersed=True)
    return _weighed(fit, rows, h, beside, [extended], [fit.with_new_noise.dispersed(extended.hyper.dispersion)])


def _weighed(
    fit: Likelihood,
    rows: Rows,
    h: Hypothesis,
    beside: Likelihood,
    with_it: Sequence[Likelihood],
    without: Sequence[Likelihood],
) -> Hypothesis:
    """Return a hypothesis with the evidence and coefficients of the likeliest models with it and without.

    What averaging over shapes, sizes and windows costs, the noise of ``beside``, which is that of the fit, has told.
    """
    noisy, k = (with_it[0], without[0]), len(fit.extra)
    positive = h.candidate.effect.prior.positive
    average = h.log_evidence - truncated(h.coefficients, h.std, positive) - (beside.log_evidence - fit.log_evidence)
    best = _likeliest(with_it, noisy)
    mean, covariance = best.coefficients(k), best.coefficients_covariance(k)
    std = np.sqrt(covariance.diagonal())
    bounds = truncated(mean, std, positive) + support(h, best, rows, mean, covariance)
    gain = best.log_evidence - _likeliest(without, noisy).log_evidence
    return replace(h, log_evidence=float(gain + average + bounds), coefficients=mean, std=std)


def _likeliest(models: Sequence[Likelihood], noisy: Sequence[Likelihood]) -> Likelihood:
    """Return the model of the greatest log evidence, its noise its own or that of one of several."""
    others = [m.with_noise_of(n) for m in models for n in noisy if n.hyper.noise is not m.hyper.noise]
    return max((*models, *others), key=lambda m: m.log_evidence)
