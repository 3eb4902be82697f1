"""The nearest physically valid coefficients, in a metric that says which errors matter.

    minimise  f(x) + kappa D(x | x0),   f(x) = 1/2 (x - x_hat)' M (x - x_hat),   kappa = epsilon f(x0)

over pseudo-inertias J > 0, with x0 the prior's mean and D its divergence. kappa follows the distance that there is to
go, so that the scale of M does not matter, and two bounds hold whatever M and x_hat are, with g the eigenvalues of
J0^-1 J of all n fitted bodies, and x* the nearest point of the closed set:

    sum (g + 1/g - 2) <= 1/epsilon,   f(x) - f(x*) <= epsilon f(x0) (4 n + tr J0^-1 J*)

Every body keeps more than about epsilon of its URDF's inertia in every direction, and that costs a few epsilon of the
distance. Both follow from convexity at the minimum, where f'(x) = kappa (J^-1 - J0^-1).

Two metrics are of use: that of ``relevance``, a weight for each parameter, with which Ting et al. make their estimate
physical, and the information of the data (the Gram matrix). The first moves parameters one by one, and so loses the
combinations that the data identifies; the second keeps them: projecting an unconstrained fit gives the constrained one.

Source: Ting, Mistry, Peters, Schaal, Nakanishi, "A Bayesian Approach to Nonlinear Parameter Identification for Rigid
Body Dynamics", RSS 2006 (there by minimisation in nonlinear coordinates; here the problem is convex).
"""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from torchrbd.errors import InputError
from torchrbd.likelihood.equations import Equations
from torchrbd.likelihood.physical_fit import fit_with_signs
from torchrbd.likelihood.urdf_prior import Prior
from torchrbd.parameters import PARAMETERS_PER_BODY
from torchrbd.robot import pseudo_inertia

# A larger one would cost more than the noise of good data: at 1e-7 the error to the true torque grew by half in places.
# So the torque error on few noisy samples grew by at most 5e-3 of itself, and every body kept more than 1e-8 (but for
# unweighted least squares 1e-6) of its own second moment in each direction.
_EPSILON = 1e-8


def project(
    prior: Prior, x_hat: Tensor, metric: Tensor, terms: Tensor | None = None, signs: Tensor | None = None
) -> Tensor:
    """Return the physical coefficients nearest to an estimate.

    The scale of the metric does not matter. An estimate whose fitted bodies fulfil the first bound above is returned as
    it is. Otherwise, what the metric gives no weight goes to the prior's mean, and so do bodies that the prior holds.

    Args:
        prior: its mean is x0, and gives each body its scale; its kappa does not matter.
        x_hat: (k,) estimate, physical or not: inertial parameters [kg, kg m, kg m^2], or these and columns of terms.
        metric: M (k, k), symmetric positive semidefinite; a diagonal may be given as (k,).
        terms: indices of the columns of terms that may move too; none by default.
        signs: (s, k) weights of sums of these columns that cannot be negative; none by default.

    Returns:
        (k,) with a positive definite pseudo-inertia for every body that the prior fits, and no negative sum.

    Raises:
        InputError: the shapes do not fit, or an entry is not finite.
    """
    k = len(x_hat)
    M = torch.diag(metric) if metric.ndim == 1 else metric
    if M.shape != (k, k):
        raise InputError(f"metric has shape {tuple(metric.shape)}, expected ({k}, {k}) or ({k},) like x_hat")
    if not bool(torch.isfinite(x_hat).all() & torch.isfinite(M).all()):
        raise InputError("x_hat or the metric has entries that are not finite; give what was not estimated no weight")
    signs = x_hat.new_zeros(0, k) if signs is None else signs
    if _inside(prior, x_hat) and bool((signs @ x_hat >= 0.0).all()):
        return x_hat.clone()
    S, away = prior.scale[:k, :k], x_hat - prior.mean[:k]
    kappa = _EPSILON * 0.5 * float(away @ M @ away)
    M = M / kappa if kappa > 0.0 else torch.zeros_like(M)
    equations = Equations(S.T @ M @ S, S.T @ (M @ away))
    free = torch.arange(0) if terms is None else terms
    signs = torch.cat((signs, signs.new_zeros(len(signs), len(prior.mean) - k)), 1)
    return fit_with_signs(replace(prior, kappa=1.0), equations, free, signs).x[:k]


def _inside(prior: Prior, x: Tensor) -> bool:
    """Say whether all fitted bodies fulfil sum (g + 1/g - 2) <= 1/epsilon."""
    L = torch.linalg.cholesky(prior.inverse_inertia)
    g = torch.linalg.eigvalsh(L.mT @ pseudo_inertia(x[prior.inertial].reshape(-1, PARAMETERS_PER_BODY)) @ L)
    return bool((g > 0.0).all()) and float((g + 1.0 / g - 2.0).sum()) <= 1.0 / _EPSILON


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
