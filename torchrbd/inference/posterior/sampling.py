"""Physically valid robots drawn from the posterior around a fit.

    p(x) ~ exp(-(x - x_L)' H (x - x_L) / 2) prod_bodies exp(-kappa D(J | J0)),   J > 0

The likelihood is quadratic in x; with the covariance from the curvature (``laplace``) H is that of the data, with the
widened covariance C it is weakened to H = C^-1 - kappa D''(x_fit), at least 0. The fit is the mode of p in both cases.
It is a density over pi, and skewed, so that its mean is not its mode: for a body without data, J follows the
Wishart distribution of 2 kappa + 5 degrees of freedom, whose mean is (2 kappa + 5) / (2 kappa) J0.

With J = F (1 + X) F' around the mode of p det(J)^(5/2), where the Wishart's mean is, and k = kappa + 5/2,

    p(x) = N(x) R(x),   log R = sum_bodies kappa logdet(1 + X) - k tr X + k tr X^2 / 2

N is the Gaussian with the curvature there. In its coordinates, e ~ N(0, 1), ``hamiltonian.py`` samples N R.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from torchrbd.errors import InputError
from torchrbd.inference.physical.fitting import FittedModel
from torchrbd.inference.posterior.hamiltonian import sample
from torchrbd.likelihood.equations import Equations
from torchrbd.likelihood.physical_fit import physical_fit
from torchrbd.likelihood.urdf_prior import Prior, local_coordinates
from torchrbd.parameters import BASIS, ORTHONORMAL, PARAMETERS_PER_BODY
from torchrbd.robot import pseudo_inertia

_WISHART, _LEAST = 2.5, 1e-13


@dataclass(frozen=True)
class RobotSamples:
    """Physically valid robots, as probable as the posterior says.

    Attributes:
        x: (n_samples, n) coefficients; the first n_params are inertial parameters.
        thinning: trajectories between two samples of a chain.
        autocorrelation: time of the slowest coordinate, in trajectories.
    """

    x: Tensor
    thinning: int
    autocorrelation: float


@dataclass(frozen=True)
class _Density:
    """R in coordinates e ~ N(0, 1), x = mode + root e; in y = local e the prior's curvature is 1."""

    mode: Tensor
    root: Tensor
    local: Tensor
    kappa: float
    n_bodies: int

    def __call__(self, e: Tensor) -> tuple[Tensor, Tensor]:
        """Return log R (K,) at y = local e, -inf outside the physical set, and its slope in e (K, n_free)."""
        k = self.kappa + _WISHART
        y = e @ self.local.T
        inertial = y[:, : self.n_bodies * PARAMETERS_PER_BODY]
        X = torch.einsum("nbk,kij->nbij", inertial.unflatten(1, (self.n_bodies, -1)), ORTHONORMAL) / k**0.5
        one = torch.eye(4, dtype=X.dtype)
        factor, info = torch.linalg.cholesky_ex(X + one)
        inside = (info == 0).all(-1)
        factor = torch.where(inside[:, None, None, None], factor, one)
        logdet = 2.0 * factor.diagonal(dim1=-2, dim2=-1).log().sum((-2, -1))
        trace = X.diagonal(dim1=-2, dim2=-1).sum((-2, -1))
        value = self.kappa * logdet - k * trace + 0.5 * inertial.square().sum(-1)
        force = self.kappa * torch.cholesky_inverse(factor) - k * one
        slope = torch.zeros_like(y)
        slope[:, : inertial.shape[1]] = torch.einsum("nbij,kij->nbk", force, ORTHONORMAL).flatten(1) / k**0.5 + inertial
        return torch.where(inside, value, -torch.inf), slope @ self.local


def sample_robots(
    prior: Prior, model: FittedModel, n_samples: int, *, widened: bool = True, seed: int = 0
) -> RobotSamples:
    """Draw robots from the posterior; every one is physically valid.

    Args:
        prior: of the fit.
        model: the fit.
        n_samples: how many.
        widened: with the covariance that respects the scatter over blocks, otherwise with that of the curvature.
        seed: of the random numbers.

    Raises:
        InputError: n_samples is not positive.
    """
    covariance = model.covariance if widened else model.laplace
    return sample_around(prior, model.x, model.free, covariance, n_samples, seed)


def sample_around(prior: Prior, x: Tensor, free: Tensor, covariance: Tensor, n_samples: int, seed: int) -> RobotSamples:
    """Draw robots around a mode, whose curvature is given by a covariance.

    Args:
        prior: around which the robots are physical.
        x: (n,) the mode.
        free: (n_free,) what may differ from it: the inertial parameters of the prior's bodies, then others.
        covariance: (n_free, n_free) there.
        n_samples: how many.
        seed: of the random numbers.

    Raises:
        InputError: n_samples is not positive.
    """
    if n_samples < 1:
        raise InputError(f"n_samples is {n_samples}, expected at least 1")
    density = _density(prior, x, free, covariance)
    found = sample(density, len(free), n_samples, seed)
    drawn = density.mode.repeat(n_samples, 1)
    drawn[:, free] += found.e @ density.root.T
    return RobotSamples(drawn, found.thinning, found.autocorrelation)


def _density(prior: Prior, x: Tensor, free: Tensor, covariance: Tensor) -> _Density:
    """Find the Gaussian that proposes: the physical fit under a prior whose mode is the Wishart's mean."""
    inertial, n = prior.inertial, len(prior.inertial)
    T = _coordinates(prior, x, free)
    inverse = _inverse(T)
    c, axes = torch.linalg.eigh(inverse @ covariance @ inverse.T)
    information = axes * (1.0 / c.clamp(_LEAST, 1.0) - 1.0)
    H = inverse.T @ information @ axes.T @ inverse
    pi = x[inertial].reshape(-1, PARAMETERS_PER_BODY)
    slope = prior.inverse_inertia - torch.linalg.inv(pseudo_inertia(pi))
    pull = torch.cat((prior.kappa * torch.einsum("bij,kij->bk", slope, BASIS).flatten(), torch.zeros(len(free) - n)))
    scale = prior.scale[free[n:], free[n:]]
    pull[n:] = torch.where(scale > 0, (x - prior.mean)[free[n:]] / scale.square(), 0.0)
    size = (prior.kappa + _WISHART) / prior.kappa
    mean, S = prior.mean.clone(), prior.scale.clone()
    mean[inertial] *= size
    S[inertial.unsqueeze(1), inertial] *= size**0.5
    wishart = replace(prior, mean=mean, inverse_inertia=prior.inverse_inertia / size, kappa=prior.kappa * size, scale=S)
    h = H @ (x - mean)[free] + pull
    scaled = torch.zeros(len(mean), len(mean), dtype=torch.float64)
    own = S[free.unsqueeze(1), free]
    scaled[free.unsqueeze(1), free] = own.T @ H @ own
    fit = physical_fit(wishart, Equations(scaled, torch.zeros_like(mean).index_copy(0, free, own.T @ h)), free[n:])
    stiffness, axes = torch.linalg.eigh(fit.precision)
    root = own @ (axes / stiffness.clamp_min(1e-3).sqrt())
    inverse = _inverse(_coordinates(replace(prior, kappa=wishart.kappa), fit.x, free))
    return _Density(fit.x, root, inverse @ root, prior.kappa, len(prior.bodies))


def _coordinates(prior: Prior, x: Tensor, free: Tensor) -> Tensor:
    """Return T (n_free, n_free): with steps T y from x the prior's curvature in y is 1."""
    terms = free[len(prior.inertial) :]
    return torch.block_diag(local_coordinates(prior, x), torch.diag(prior.scale.diagonal()[terms]))


def _inverse(T: Tensor) -> Tensor:
    """Return the inverse of T, zero for terms whose feature never occurs: they have no scale and stay."""
    dead = torch.diag((T == 0.0).all(0).double())
    return torch.linalg.inv(T + dead) - dead
