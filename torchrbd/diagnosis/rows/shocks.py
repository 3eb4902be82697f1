"""Whether shocks spoil a fit: the same terms fitted without them leave less elsewhere, and err at them far more.

At a shock the recorded positions are not those of what the torque moves (``likelihood/shocks.py``), and a model
that is to fit both has inertial parameters that fit neither. That is asked of what the search has found: where a term
is missing that grows with the torque, shocks have the largest errors too, until it is found.
"""

from __future__ import annotations

import numpy as np
import torch

from torchrbd.diagnosis.rows.regression import Fit, fitted
from torchrbd.diagnosis.rows.weighing import weighed

# A shock is so many times what is usual at a joint (the median of its samples).
_SHOCK = 4.0
# They spoil a fit if one without them leaves less than this part elsewhere, and errs at them by more than so many times
# what it does elsewhere (benchmarks/shocks.py).
SPOILED, MISFIT = 0.8, 5.0
# So much of the recording must remain.
_LEAST_CALM = 0.3


def without_shocks(fit: Fit) -> Fit:
    """Return the fit of the same terms without shocks if they spoil it, else the fit."""
    calm = calmed(fit)
    return calm if left_elsewhere(fit, calm) < SPOILED and misfit_ratio(calm).max() > MISFIT else fit


def calmed(fit: Fit) -> Fit:
    """Return the fit of the same terms without shocks; the fit itself where there are none, or little else."""
    samples = fit.rows.samples
    calm = samples.without_shocks(torch.from_numpy(_SHOCK * np.median(samples.shocks, axis=1)))
    counts = calm.weight.any(0)
    if counts.all() or counts.mean() < _LEAST_CALM:
        return fit
    return weighed(fitted(calm, fit.rows.prior, fit.terms, fit.rows.noise, fit.extra))


def left_elsewhere(fit: Fit, calm: Fit) -> float:
    """Return the RMS that the calm fit leaves elsewhere, in parts of the fit's, at the joint where it is least."""
    samples = calm.rows.samples
    counts, seen = samples.weight.any(0), samples.seen
    left = [np.sqrt(np.mean((samples.weight * f.leftover())[seen][:, counts] ** 2, axis=1)) for f in (fit, calm)]
    return float((left[1] / np.maximum(left[0], 1e-300)).min())


def misfit(calm: Fit) -> tuple[np.ndarray, np.ndarray]:
    """Return the RMS that a fit without shocks leaves at them, and elsewhere, (n,) each [N m] or [N].

    Zero where a joint's torque is not measured.
    """
    samples, square = calm.rows.samples, calm.leftover() ** 2
    shocked = samples.measured & (samples.weight == 0.0)
    at, elsewhere = (
        np.sqrt((square * here).sum(1) / np.maximum(here.sum(1), 1)) for here in (shocked, samples.measured & ~shocked)
    )
    return at, elsewhere


def misfit_ratio(calm: Fit) -> np.ndarray:
    """Return the first in parts of the second, (n,)."""
    at, elsewhere = misfit(calm)
    return at / np.maximum(elsewhere, 1e-300)
