"""The nearest physically valid parameters, in a metric that says which errors matter.

    minimise  (pi - pi_hat)' M (pi - pi_hat)   over pseudo-inertias J > 0

Two metrics are of use: that of ``relevance``, a weight for each parameter, with which Ting et al. make their estimate
physical, and the precision of the posterior (the Gram matrix). The first moves parameters one by one, and so loses the
combinations that the data has told; the second keeps them: projecting an unconstrained fit gives the constrained one.

Source: Ting, Mistry, Peters, Schaal, Nakanishi, "A Bayesian Approach to Nonlinear Parameter Identification for Rigid
Body Dynamics", RSS 2006 (there by minimisation in nonlinear coordinates; here the problem is convex).
"""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from torchrbd.errors import InputError
from torchrbd.inference.physical.map_fit import Scaled
from torchrbd.inference.physical.physical_fit import physical_fit
from torchrbd.inference.physical.prior import Prior

# Weight of the divergence from the prior, the metric's largest entry in prior standard deviations (of kappa 1) being 1:
# it keeps the result off the boundary, and holds what the metric has no weight for.
_BARRIER = 1e-12


def project(prior: Prior, pi_hat: Tensor, metric: Tensor) -> Tensor:
    """Return the physical parameters nearest to an estimate, strictly inside the physical set.

    The scale of the metric does not matter. What the metric gives less than 1e-12 of its largest weight (in prior
    standard deviations) stays near the prior's mean, as bodies do that the prior holds.

    Args:
        prior: its mean is where the search starts, and gives each body its scale.
        pi_hat: (n_params,) estimate, physical or not.
        metric: M (n_params, n_params), symmetric positive semidefinite; a diagonal may be given as (n_params,).

    Returns:
        (n_params,) with a positive definite pseudo-inertia for every body that the prior fits.

    Raises:
        InputError: the shapes do not fit, or an entry is not finite.
    """
    n = len(pi_hat)
    M = torch.diag(metric) if metric.ndim == 1 else metric
    if M.shape != (n, n):
        raise InputError(f"metric has shape {tuple(metric.shape)}, expected ({n}, {n}) or ({n},) like pi_hat")
    if not bool(torch.isfinite(pi_hat).all() & torch.isfinite(M).all()):
        raise InputError("pi_hat or the metric has entries that are not finite; give what was not estimated no weight")
    S = prior.scale[:n, :n]
    H, h = S.T @ M @ S, S.T @ (M @ (pi_hat - prior.mean[:n]))
    largest = prior.kappa * float(H.diagonal().max())
    weight = 1.0 / largest if largest > 0.0 else 0.0
    fit = physical_fit(replace(prior, kappa=_BARRIER), Scaled(weight * H, weight * h), torch.arange(0))
    return fit.x[:n]


def relevance(precision: Tensor, variance: Tensor) -> Tensor:
    """Return how much the data itself says of each coefficient of an ARD regression, (d,): 1 / variance - precision.

    A coefficient that ARD has found irrelevant, its posterior being its prior, has none.

    Args:
        precision: (d,) of the ARD prior, alpha; infinite where a coefficient was pruned.
        variance: (d,) of the posterior; zero where a coefficient was pruned.
    """
    live = torch.isfinite(precision) & (variance > 0)
    found = torch.where(live, variance, 1.0).reciprocal() - torch.where(live, precision, 1.0)
    return torch.where(live, found.clamp_min(0.0), 0.0)
