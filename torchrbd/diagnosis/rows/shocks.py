"""Whether shocks spoil the fit: what is fitted without them leaves far less elsewhere.

At a shock the recorded positions are not those of what the torque moves (``inference/data/shocks.py``), and a model
that is to fit both has inertial parameters that fit neither. In recordings whose shocks are those of the bodies,
leaving them out changes little.
"""

from __future__ import annotations

import numpy as np
import torch

from torchrbd.diagnosis.rows.regression import Fit, fitted
from torchrbd.diagnosis.rows.weighing import weighed

# A shock is so many times what is usual at a joint (the median of its samples).
_SHOCK = 4.0
# They spoil a fit that leaves, at some joint and elsewhere, more than 1 / this of what one without them does. In 50
# concealed cases of all kinds without play that ratio is .73 to 1.2, in three of five with play of 7 % and more .05
# to .11.
_SPOILED = 0.5
# So much of the recording must remain.
_LEAST_CALM = 0.3


def without_shocks(fit: Fit) -> Fit:
    """Return the fit of the same terms without shocks if they spoil it, else the fit."""
    samples = fit.rows.samples
    levels = _SHOCK * np.median(samples.shocks, axis=1)
    calm = samples.without_shocks(torch.from_numpy(levels))
    counts = calm.weight.any(0)
    if counts.all() or counts.mean() < _LEAST_CALM:
        return fit
    other = weighed(fitted(calm, fit.rows.prior, fit.terms, fit.rows.noise, fit.extra))
    before, after = (np.sqrt(np.mean((calm.weight * f.leftover())[:, counts] ** 2, axis=1)) for f in (fit, other))
    return other if (after < _SPOILED * before).any() else fit
