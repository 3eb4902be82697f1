"""Shapes of the greatest evidence: from the best point of a refined grid, Gauss-Newton steps to the maximum,

    tau(theta + d) = sum_k w_k phi_k(theta) + d sum_k w_k dphi_k / dtheta

The cost of averaging over shapes is that of the first refinement, where the whole grid was tried.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch

from torchrbd.dataset.columns import Candidate
from torchrbd.dataset.rows import Rows
from torchrbd.dataset.shapes import ShapeSlope, slopes, varied
from torchrbd.diagnosis.hypotheses import LEAST_GAIN, Hypothesis, agree_shape, hypothesis_of, prior_std
from torchrbd.diagnosis.screening import refine_shape, start_each_kind
from torchrbd.effects import Site
from torchrbd.likelihood.extra import Extra
from torchrbd.likelihood.gaussian import added
from torchrbd.likelihood.likelihood import Likelihood

# Steps, and halvings of one that leads downhill.
_STEPS, _HALVINGS = 6, 3
# What is fast is modelled worse: about as many times what rows say as shapes of a development set err by (seed 9203, a
# play and a crank with another summit left out: Student's tails allow for such).
_WORSE = 2.0


def best_shape(fit: Likelihood, rows: Rows, h: Hypothesis) -> Hypothesis:
    """Return a hypothesis at the best shape, or window, given a fit: the best of each kind."""
    every = (_best_of_kind(fit, rows, one) for one in start_each_kind(fit, rows, h))
    return max(every, key=lambda one: one.log_evidence - one.paid)


def _best_of_kind(fit: Likelihood, rows: Rows, h: Hypothesis) -> Hypothesis:
    one = refine_shape(fit, rows, h)
    if one.candidate.site.window is not None:
        return one
    best = hypothesis_of(fit, rows, find_summit(fit, rows, one).candidate)
    if best is None:
        return one
    best = replace(best, log_evidence=best.log_evidence + one.paid, tried=one.tried, paid=one.paid)
    return best if best.log_evidence > one.log_evidence else one


def find_summit(fit: Likelihood, rows: Rows, h: Hypothesis) -> Hypothesis:
    """Return a hypothesis at the shape of the greatest evidence that Gauss-Newton steps find."""
    best, free = hypothesis_of(fit, rows, h.candidate), varied(rows.columns, h.candidate)
    for _ in range(_STEPS if best is not None and free else 0):
        assert best is not None
        before, step = best, _step(fit, rows, h, best)
        for part in (0.5**k for k in range(_HALVINGS + 1)):
            shape = {name: now + part * step.get(name, 0.0) for name, now in before.candidate.shape.items()}
            site = before.candidate.site
            next_one = hypothesis_of(fit, rows, rows.columns.candidate(before.candidate.effect, site, shape))
            if next_one is not None and next_one.log_evidence > before.log_evidence:
                best = agree_shape(fit, rows, next_one)
                break
        if best.log_evidence < before.log_evidence + LEAST_GAIN:
            break
    best = None if best is None else agree_shape(fit, rows, best)
    return h if best is None else replace(best, scale=h.scale, tried=h.tried, paid=h.paid)


def shape_stds(fit: Likelihood, rows: Rows, terms: Sequence[Candidate]) -> dict[tuple[str, Site], dict[str, float]]:
    """Return by effect and site the standard deviations of a fit's shapes given all else."""
    at, extras = list[ShapeSlope](), list[Extra]()
    for k, c in enumerate(terms):
        free = varied(rows.columns, c)
        for slope in slopes(rows.columns, c, torch.from_numpy(fit.coefficients(k))):
            at.append(slope)
            extras.append(Extra(c.place, _features(rows, slope), np.array([free[slope.parameter].std])))
    extended, found = fit.extended((*fit.extra, *extras)), dict[tuple[str, Site], dict[str, float]]()
    for k, slope in enumerate(at, len(fit.extra)):
        std = float(extended.coefficients_covariance(k)[0, 0]) ** 0.5
        found.setdefault((slope.effect.id, slope.site), {})[slope.parameter] = _WORSE * std
    return found


def _features(rows: Rows, slope: ShapeSlope) -> np.ndarray:
    return rows.evaluated(lambda signals: torch.stack(list(slope.features(signals).values())))


def _step(fit: Likelihood, rows: Rows, h: Hypothesis, now: Hypothesis) -> dict[str, float]:
    """Return the Gauss-Newton step of each shape parameter, within its limits."""
    c, axes = now.candidate, varied(rows.columns, now.candidate)
    around = slopes(rows.columns, c, torch.from_numpy(now.coefficients))
    F = [_features(rows, s) for s in around]
    S, r = fit.precision_and_score(c.place, np.concatenate((rows.features(c), *F)))
    widths = np.array([axes[s.parameter].std for s in around])
    std = np.concatenate((prior_std(fit, rows, c)[0] * h.scale, widths))
    steps = dict[str, float]()
    for s, step in zip(around, added(S, r, std).mean[-len(F) :], strict=True):
        value = c.shape[s.parameter]
        steps[s.parameter] = float(np.clip(value + step, *axes[s.parameter].limits(value)) - value)
    return steps
