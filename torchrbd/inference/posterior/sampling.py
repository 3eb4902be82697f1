"""Physically valid robots drawn from the posterior around a fit.

    p(x) ~ exp(-(x - x_L)' H (x - x_L) / 2) prod_bodies exp(-kappa D(J | J0)),   J > 0

The likelihood is quadratic in x; with the covariance from the curvature (``laplace``) H is that of the data, with the
widened covariance C it is weakened to H = C^-1 - kappa D''(x_fit), at least 0. The fit is the mode of p in both cases.
It is a density over pi, and skewed, so that its mean is not its mode: of a body that no data tells, J follows the
Wishart distribution of 2 kappa + 5 degrees of freedom, whose mean is (2 kappa + 5) / (2 kappa) J0.

With J = F (1 + X) F' around the mode of p det(J)^(5/2), where the Wishart's mean is, and k = kappa + 5/2,

    p(x) = N(x) R(x),   log R = sum_bodies kappa logdet(1 + X) - k tr X + k tr X^2 / 2

N is the Gaussian with the curvature there. Hamiltonian trajectories follow N exactly, by turning on ellipses, whatever
its condition; only R needs steps. Elliptical slice sampling (Murray, Adams, MacKay 2010) turns on the same ellipses but
does not use the slope of R: with 7 bodies its autocorrelation time was 25 to 140 turns, here it is about 3.

Source: Shahbaba, Lan, Johnson, Neal, "Split Hamiltonian Monte Carlo", Statistics and Computing 2014, section 3;
autocorrelation times by Sokal's window.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from torchrbd.errors import InputError
from torchrbd.inference.physical.fitting import FittedModel
from torchrbd.inference.physical.map_fit import Scaled
from torchrbd.inference.physical.physical_fit import physical_fit
from torchrbd.inference.physical.prior import Prior
from torchrbd.parameters import BASIS, ORTHONORMAL, PARAMETERS_PER_BODY
from torchrbd.robot import from_pseudo_inertia, pseudo_inertia

_CHAINS, _PILOT, _MOST_THINNING, _WINDOW = 64, 128, 32, 5.0
# Radians that a trajectory turns, in steps of a length with this acceptance; the length is jittered against resonance.
_TURN, _ACCEPTANCE, _JITTER = 1.6, 0.65, 0.2
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
    if n_samples < 1:
        raise InputError(f"n_samples is {n_samples}, expected at least 1")
    density = _density(prior, model, model.covariance if widened else model.laplace)
    chains = _chains(density, min(_CHAINS, n_samples), torch.Generator().manual_seed(seed))
    pilot = torch.stack([next(chains) for _ in range(_PILOT)])
    # The first half is for forgetting that all chains start at the same place.
    time = autocorrelation_time(pilot[_PILOT // 2 :])
    thinning = min(max(1, round(2.0 * time)), _MOST_THINNING)
    kept: list[Tensor] = []
    while sum(map(len, kept)) < n_samples:
        for _ in range(thinning - 1):
            next(chains)
        kept.append(next(chains))
    x = density.mode.repeat(n_samples, 1)
    x[:, model.free] += torch.cat(kept)[:n_samples] @ density.root.T
    return RobotSamples(x, thinning, time)


def _density(prior: Prior, model: FittedModel, covariance: Tensor) -> _Density:
    """Find the Gaussian that proposes: the physical fit under a prior whose mode is the Wishart's mean."""
    free, inertial, n = model.free, prior.inertial, len(prior.inertial)
    T = _coordinates(prior, model.x, free, prior.kappa)
    inverse = _inverse(T)
    c, axes = torch.linalg.eigh(inverse @ covariance @ inverse.T)
    information = axes * (1.0 / c.clamp(_LEAST, 1.0) - 1.0)
    H = inverse.T @ information @ axes.T @ inverse
    pi = model.x[inertial].reshape(-1, PARAMETERS_PER_BODY)
    slope = prior.inverse_inertia - torch.linalg.inv(pseudo_inertia(pi))
    pull = torch.cat((prior.kappa * torch.einsum("bij,kij->bk", slope, BASIS).flatten(), torch.zeros(len(free) - n)))
    scale = prior.scale[free[n:], free[n:]]
    pull[n:] = torch.where(scale > 0, (model.x - prior.mean)[free[n:]] / scale.square(), 0.0)
    size = (prior.kappa + _WISHART) / prior.kappa
    mean, S = prior.mean.clone(), prior.scale.clone()
    mean[inertial] *= size
    S[inertial.unsqueeze(1), inertial] *= size**0.5
    wishart = replace(prior, mean=mean, inverse_inertia=prior.inverse_inertia / size, kappa=prior.kappa * size, scale=S)
    h = H @ (model.x - mean)[free] + pull
    scaled = torch.zeros(len(mean), len(mean), dtype=torch.float64)
    own = S[free.unsqueeze(1), free]
    scaled[free.unsqueeze(1), free] = own.T @ H @ own
    fit = physical_fit(wishart, Scaled(scaled, torch.zeros_like(mean).index_copy(0, free, own.T @ h)), free[n:])
    stiffness, axes = torch.linalg.eigh(fit.precision)
    root = own @ (axes / stiffness.clamp_min(1e-3).sqrt())
    inverse = _inverse(_coordinates(prior, fit.x, free, wishart.kappa))
    return _Density(fit.x, root, inverse @ root, prior.kappa, len(prior.bodies))


def _coordinates(prior: Prior, x: Tensor, free: Tensor, kappa: float) -> Tensor:
    """Return T (n_free, n_free): with steps T y from x the prior's curvature in y is 1."""
    F = torch.linalg.cholesky(pseudo_inertia(x[prior.inertial].reshape(-1, PARAMETERS_PER_BODY)))
    bodies = (from_pseudo_inertia(f @ ORTHONORMAL @ f.mT).T / kappa**0.5 for f in F)
    terms = free[len(prior.inertial) :]
    return torch.block_diag(*bodies, torch.diag(prior.scale.diagonal()[terms]))


def _inverse(T: Tensor) -> Tensor:
    """Return the inverse of T, zero for terms whose feature never occurs: they have no scale and stay."""
    dead = torch.diag((T == 0.0).all(0).double())
    return torch.linalg.inv(T + dead) - dead


def _chains(density: _Density, n_chains: int, generator: torch.Generator) -> Iterator[Tensor]:
    """Yield the states e (n_chains, n_free) of independent chains, one trajectory after the other.

    The step length is adapted over the first half of the pilot run and then kept.
    """

    def draw(*shape: int) -> Tensor:
        return torch.randn(*shape, generator=generator, dtype=torch.float64)

    e = torch.zeros(n_chains, len(density.root), dtype=torch.float64)
    value, slope = density(e)
    length, count = 0.4, 0
    while True:
        momentum = draw(*e.shape)
        new, new_value, new_slope = e, value, slope
        energy = value - 0.5 * (e.square() + momentum.square()).sum(1)
        angle = length * (1.0 + _JITTER * float(draw(1).clamp(-2.0, 2.0)))
        for _ in range(max(1, round(_TURN / length))):
            momentum = momentum + 0.5 * angle * new_slope
            new, momentum = (
                new * math.cos(angle) + momentum * math.sin(angle),
                momentum * math.cos(angle) - new * math.sin(angle),
            )
            new_value, new_slope = density(new)
            momentum = momentum + 0.5 * angle * new_slope
        gain = new_value - 0.5 * (new.square() + momentum.square()).sum(1) - energy
        accepted = torch.rand(n_chains, generator=generator, dtype=torch.float64).log() < gain
        e = torch.where(accepted.unsqueeze(1), new, e)
        slope = torch.where(accepted.unsqueeze(1), new_slope, slope)
        value = torch.where(accepted, new_value, value)
        if count < _PILOT // 2:
            share = float(gain.clamp_max(0.0).exp().nan_to_num(0.0).mean())
            length = min(_TURN, length * math.exp((share - _ACCEPTANCE) / (1.0 + 0.1 * count)))
        count += 1
        yield e


def autocorrelation_time(series: Tensor) -> float:
    """Return the integrated autocorrelation time of the slowest coordinate, in steps, at least 1.

        tau = 1 + 2 sum_{t=1..W} rho_t,   W the first with W >= 5 tau

    Args:
        series: (n_steps, n_chains, n), stationary; the autocorrelation is averaged over the chains.
    """
    n_steps = len(series)
    centred = series - series.mean((0, 1))
    spectrum = torch.fft.rfft(centred, 2 * n_steps, dim=0)
    overlap = torch.arange(n_steps, 0, -1, dtype=series.dtype).unsqueeze(1)
    covariance = torch.fft.irfft(spectrum.abs().square(), 2 * n_steps, dim=0)[:n_steps].mean(1) / overlap
    live = covariance[0] > 1e-300
    if not bool(live.any()):
        return 1.0
    tau = 2.0 * (covariance[:, live] / covariance[0, live]).cumsum(0) - 1.0
    wide = torch.arange(n_steps).unsqueeze(1) >= _WINDOW * tau
    first = torch.where(wide.any(0), wide.double().argmax(0), torch.tensor(n_steps // 2))
    return max(1.0, float(tau.gather(0, first.unsqueeze(0)).max()))
