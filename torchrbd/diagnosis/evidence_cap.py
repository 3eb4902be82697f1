"""How much evidence an estimate gives by itself: an effect is no surer than its reported value and interval.

The search takes its evidence from whitened rows of a wide band. Values and intervals come from the fit in its own band;
they allow for correlated noise through the scatter of the fit between blocks of time. Both describe one effect, so its
probability uses the smaller evidence of the two. With the estimate w = w0 + d and its covariance C taken as the data,

    log B = log N(d | 0, C + D^2) - log N(d | 0, C)

with w0 the value without the effect and D the prior's standard deviations. Where the interval of a single coefficient
holds w0, log B is below 1.92: such an effect is never reported as certain.

Source: Wakefield, "Bayes factors for genome-wide association studies: comparison with P-values", Genet. Epidemiol.
2009, eq. 2.
"""

from __future__ import annotations

import math
from collections.abc import Collection

import numpy as np
import torch

from torchrbd.dataset.columns import Candidate
from torchrbd.diagnosis.hypotheses import SHARED
from torchrbd.inference.physical.fitting import FittedModel

# Directions of a correlation matrix below this are rounding.
_LEAST_DIRECTION = 1e-9


def bayes_factor(difference: np.ndarray, covariance: np.ndarray, prior_std: np.ndarray) -> float:
    """Return log B of an estimate against "no effect", in nats.

    Args:
        difference: d (K,), of the estimate from the value without the effect.
        covariance: C (K, K).
        prior_std: D (K,), above zero.
    """
    d, R = difference / prior_std, covariance / prior_std / prior_std[:, None]
    values, axes = np.linalg.eigh(R)
    values = np.maximum(values, _LEAST_DIRECTION * values[-1])
    z = (axes.T @ d) ** 2
    return 0.5 * float((z / values - z / (1.0 + values) - np.log1p(1.0 / values)).sum())


def evidence_of_estimate(
    model: FittedModel,
    term: Candidate,
    prior_std: np.ndarray,
    wide_band: np.ndarray | None,
    none: np.ndarray | float = 0.0,
    labels: Collection[str] | None = None,
) -> float:
    """Return the log evidence that a fitted term's estimate gives for it; infinite if nothing of it is estimated.

    The covariance is widened along the direction in which the term is most certain, by what the reported intervals are
    widened there.

    Args:
        model: the fit.
        term: one of its terms.
        prior_std: (K,) of its coefficients.
        wide_band: (K, K) their covariance in the likelihood of the search, or None.
        none: (K,) coefficients without the effect.
        labels: of the columns that count. Default: all but those that joint friction has as well, if there are others.
    """
    w, C = (x.numpy() for x in model.coefficients(term))
    counted = [label in labels if labels is not None else label not in SHARED for label in term.labels]
    live = (C.diagonal() > 0.0) & (prior_std > 0.0)
    used = np.flatnonzero(live & counted if labels is not None or (live & counted).any() else live)
    if not len(used):
        return math.inf
    d, C, D = (w - none)[used], C[np.ix_(used, used)], prior_std[used]
    size = np.sqrt(C.diagonal())
    g = np.linalg.pinv(C / size / size[:, None], rcond=_LEAST_DIRECTION, hermitian=True) @ (d / size) / size
    length = math.sqrt(max(float(g @ C @ g), 0.0))
    if length == 0.0:
        return bayes_factor(d, C, D)
    g, widening = g / length, 1.0
    if model.scatter is not None:
        at = torch.zeros(len(model.free), dtype=torch.float64)
        at[model.position(term)[used]] = torch.from_numpy(g)
        widening = max(widening, model.scatter.variance(at, 1.0))
    if wide_band is not None:
        widening = max(widening, float(g @ wide_band[np.ix_(used, used)] @ g))
    along = C @ g
    return bayes_factor(d, C + (widening - 1.0) * np.outer(along, along), D)
