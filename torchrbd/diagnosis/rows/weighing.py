"""The weight of samples where joints may stick, by the noise that rows show.

The first estimate of the noise is from blocks. Where a joint sticks in most of them, friction at rest that motion does
not determine adds to the error. The noise then seems larger than it is, and the joint's friction smaller against it.
"""

from __future__ import annotations

import torch

from torchrbd.diagnosis.rows.regression import Fit, fitted

_ROUNDS = 2


def weighed(fit: Fit) -> Fit:
    """Return a fit of the same terms, samples weighed by the Coulomb friction and the noise that it shows."""
    for number in range(_ROUNDS):
        samples, rows = fit.rows.samples, fit.rows
        levels = samples.columns.stick_levels.clone()
        for term in fit.terms:
            moves = samples.columns.scale(term.site).moves
            if term.effect.urdf_tag == "friction" and moves and rows.counts[term.joint]:
                (coulomb,), j = fit.coefficients(term), term.joint
                level = abs(coulomb) / rows.noises[j].std
                # Joints whose friction the first fit is not sure of have none.
                levels[j] = level if levels[j] > 0 else 0.0
        if number and torch.allclose(levels, samples.columns.stick_levels, rtol=0.1):
            break
        fit = fitted(samples.sticking(levels), rows.prior, fit.terms, rows.noise, fit.extra, rounds=2)
    return fit
