"""The posterior around a physically valid fit: robots drawn from it, and the variance of the torque that it predicts.

    p(x) ~ exp(-(x - x_L)' H (x - x_L) / 2) prod_bodies exp(-kappa D(J | J0)),   J > 0

The likelihood is quadratic in x; with the covariance from the curvature (``laplace``) H is that of the data, with the
widened covariance C it is weakened to H = C^-1 - kappa D''(x_fit), at least 0. The fit is the mode of p in both cases.
It is a density over pi, and skewed, so that its mean is not its mode: of a body that no data tells, J follows the
Wishart distribution of 2 kappa + 5 degrees of freedom, whose mean is (2 kappa + 5) / (2 kappa) J0.

Proposals come from a Gaussian around the mode of p det(J)^(5/2), where the Wishart's mean is, with the curvature there:
with J = F (1 + X) F' around that mode and k = kappa + 5/2,

    p(x) ~ N(x) exp(kappa logdet(1 + X) - k tr X + k tr X^2 / 2)

Source: Murray, Adams, MacKay, "Elliptical slice sampling", AISTATS 2010; autocorrelation times by Sokal's window.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from torchrbd.errors import InputError
from torchrbd.inference.fitting import FittedModel
from torchrbd.inference.map_fit import Scaled
from torchrbd.inference.physical_fit import physical_fit
from torchrbd.inference.prior import Prior
from torchrbd.parameters import BASIS, ORTHONORMAL, PARAMETERS_PER_BODY
from torchrbd.physics import JointState
from torchrbd.robot import from_pseudo_inertia, pseudo_inertia

# The Gaussian that proposes has this part of the prior's curvature: the prior's tails are heavier than a Gaussian's.
_SLACK = 0.8
_CHAINS, _PILOT, _MOST_THINNING, _WINDOW = 256, 512, 128, 5.0
_WISHART = 2.5
_LEAST = 1e-13
_CHUNK = 2048


@dataclass(frozen=True)
class RobotSamples:
    """Physically valid robots, as probable as the posterior says.

    Attributes:
        x: (n_samples, n) coefficients; the first n_params are inertial parameters.
        thinning: sweeps of the sampler between two samples of a chain.
        autocorrelation: of the slowest coordinate, in sweeps.
    """

    x: Tensor
    thinning: int
    autocorrelation: float


@dataclass(frozen=True)
class PredictiveVariance:
    """Variance of a predicted torque, [(N m)^2] or [N^2].

    Attributes:
        parameters: (*batch, n_dof) Y cov Y', from what is not known of the coefficients.
        noise: (n_dof,) of the band-limited torque that the model does not explain; inf without recorded torque.
    """

    parameters: Tensor
    noise: Tensor


@dataclass(frozen=True)
class _Density:
    """p in coordinates y with x = mode + T y, where the prior's curvature is 1: log p / N(y; 0, root root')."""

    mode: Tensor
    T: Tensor
    root: Tensor
    kappa: float
    n_bodies: int

    def __call__(self, y: Tensor) -> Tensor:
        """Return the log density (K,) of y (K, n_free), -inf outside the physical set."""
        k = self.kappa + _WISHART
        inertial = y[:, : self.n_bodies * PARAMETERS_PER_BODY].reshape(len(y), self.n_bodies, PARAMETERS_PER_BODY)
        X = torch.einsum("nbk,kij->nbij", inertial, ORTHONORMAL) / k**0.5
        factor, info = torch.linalg.cholesky_ex(X + torch.eye(4, dtype=X.dtype))
        logdet = 2.0 * factor.diagonal(dim1=-2, dim2=-1).log().sum(-1)
        trace = X.diagonal(dim1=-2, dim2=-1).sum(-1)
        beyond = (self.kappa * logdet - k * trace).sum(-1) + 0.5 * inertial.square().sum((-2, -1))
        return torch.where((info == 0).all(-1), beyond - 0.5 * (1.0 - _SLACK) * y.square().sum(-1), -torch.inf)


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
    generator = torch.Generator().manual_seed(seed)
    sweeps = _sweeps(density, min(_CHAINS, n_samples), generator)
    pilot = torch.stack([next(sweeps) for _ in range(_PILOT)])
    # The first half is for forgetting that all chains start at the same place.
    time = autocorrelation_time(pilot[_PILOT // 2 :])
    thinning = min(max(1, round(2.0 * time)), _MOST_THINNING)
    kept: list[Tensor] = []
    while sum(map(len, kept)) < n_samples:
        for _ in range(thinning - 1):
            next(sweeps)
        kept.append(next(sweeps))
    x = density.mode.repeat(n_samples, 1)
    x[:, model.free] += torch.cat(kept)[:n_samples] @ density.T.T
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
    T = _coordinates(prior, fit.x, free, wishart.kappa)
    inverse = _inverse(T) @ own
    c, axes = torch.linalg.eigh(inverse @ torch.linalg.inv(fit.precision) @ inverse.T)
    c = c.clamp(0.0, 1.0)
    root = axes * (c / (1.0 - (1.0 - _SLACK) * c)).sqrt()
    return _Density(fit.x, T, root, prior.kappa, len(prior.bodies))


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


def _sweeps(density: _Density, n_chains: int, generator: torch.Generator) -> Iterator[Tensor]:
    """Yield the states (n_chains, n_free) of independent chains, one step after the other, started at the fit."""
    n = len(density.root)
    draw = lambda *shape: torch.rand(*shape, generator=generator, dtype=torch.float64)  # noqa: E731
    y = torch.zeros(n_chains, n, dtype=torch.float64)
    value = density(y)
    while True:
        partner = torch.randn(n_chains, n, generator=generator, dtype=torch.float64) @ density.root.T
        level = value + draw(n_chains).log()
        angle = 2.0 * torch.pi * draw(n_chains)
        low, high = angle - 2.0 * torch.pi, angle.clone()
        waiting = torch.arange(n_chains)
        state, value = y.clone(), value.clone()
        while len(waiting):
            a = angle[waiting].unsqueeze(1)
            proposal = y[waiting] * a.cos() + partner[waiting] * a.sin()
            found = density(proposal)
            accepted = found > level[waiting]
            done = waiting[accepted]
            state[done], value[done] = proposal[accepted], found[accepted]
            waiting = waiting[~accepted]
            # The bracket shrinks towards angle 0, the present state, so that every chain is accepted in the end.
            at = angle[waiting]
            low[waiting] = torch.where(at < 0, at, low[waiting])
            high[waiting] = torch.where(at < 0, high[waiting], at)
            angle[waiting] = low[waiting] + (high[waiting] - low[waiting]) * draw(len(waiting))
        y = state
        yield y


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


def predictive_variance(model: FittedModel, q: Tensor, qd: Tensor, qdd: Tensor) -> PredictiveVariance:
    """Return how uncertain the model's torque is.

        var tau_j = a_j cov(x) a_j' + sigma_j^2,   a_j = [Y_j, phi_j]

    Args:
        model: the fit; its ``covariance`` counts.
        q, qd, qdd: (*batch, n_dof) [rad or m, per s, per s^2].
    """
    robot, columns = model.columns.robot, model.columns
    batch = q.shape[:-1]
    q, qd, qdd = (v.reshape(-1, robot.n_dof).to(torch.float64) for v in (q, qd, qdd))
    cov = torch.zeros(columns.n, columns.n, dtype=torch.float64)
    cov[model.free.unsqueeze(1), model.free] = model.covariance
    found = []
    for at in zip(*(v.split(_CHUNK) for v in (q, qd, qdd)), strict=True):
        Y = robot.regressor_batch_last(*(v.T for v in at))
        rows = []
        for joint in range(robot.n_dof):
            index, a = _row(model, joint, Y[joint], *(v[:, joint] for v in at))
            rows.append(torch.einsum("kn,kl,ln->n", a, cov[index.unsqueeze(1), index], a))
        found.append(torch.stack(rows, -1))
    variance = torch.cat(found) if found else q.new_zeros(0, robot.n_dof)
    return PredictiveVariance(variance.reshape(*batch, robot.n_dof), model.noise_variance)


def _row(model: FittedModel, joint: int, Y: Tensor, q: Tensor, qd: Tensor, qdd: Tensor) -> tuple[Tensor, Tensor]:
    """Return the indices in x (K,) of what acts on a joint, and a_j (K, N)."""
    columns = model.columns
    state = JointState(q, qd, qdd, columns.scales[joint].rest_width)
    features: dict[int, Tensor] = {}
    for candidate in model.terms:
        if candidate.joint == joint:
            found = candidate.effect.features(state, candidate.shape)
            features.update({columns.index(joint, label): value for label, value in found.items()})
    index = torch.cat((columns.inertial[joint], torch.tensor(list(features), dtype=torch.long)))
    return index, torch.cat((Y[columns.inertial[joint]], *(v.unsqueeze(0) for v in features.values())))
