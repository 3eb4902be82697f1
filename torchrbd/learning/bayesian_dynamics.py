"""The posterior of a robot as a module: torques with their uncertainty, robots to train with, and a loss.

The mean is a physical robot, trained in log-Cholesky coordinates and coefficients theta. Around it the inertial
parameters and coefficients x = (pi, w), in which the torque is linear, are Gaussian:

    theta = theta_0 + W m,   x ~ N(x(theta), R R'),   R = V T

m, T and the noise sigma are fitted by autograd to the evidence lower bound of independent samples,

    ELBO = sum_ij E log N(tau_ij | tau_j(x), sigma_j^2) - KL
    E (tau - tau(x))^2 = (tau - tau(theta))^2 + A R R' A',   A = dtau/dx = [Y, phi]
    KL = kappa sum_bodies (D + tr(D'' R R') / 2) + that of the coefficients - log det T + const

with D the entropic divergence from the URDF's bodies, the prior of ``identify``, to second order. With much data the
mean is therefore that of the convex fit; with known bodies the whole posterior is that of the closed form.

Source: Ting, Mistry, Peters, Schaal, Nakanishi, "A Bayesian Approach to Nonlinear Parameter Identification for Rigid
    Body Dynamics", RSS 2006, for variational inference of these parameters (of inputs without noise here).
"""

from __future__ import annotations

import copy
import math
from collections.abc import Collection
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from torchrbd.display import brief
from torchrbd.errors import InputError
from torchrbd.inference.posterior.posterior import Posterior
from torchrbd.inference.posterior.sampling import sample_around
from torchrbd.learning.body_prior import as_prior, curvature, divergence
from torchrbd.learning.coordinates import (
    felt,
    fitted_covariance,
    flatten,
    linear,
    linear_entries,
    linear_positions,
    physics_columns,
    slopes,
    unflatten,
)
from torchrbd.learning.many_robots import ManyRobots
from torchrbd.learning.predictions import ExternalTorque, Prediction
from torchrbd.likelihood.urdf_prior import KAPPA, TERM_WIDTH, inverse_root
from torchrbd.model import RigidBodyDynamics
from torchrbd.model.files import read_model, write_model
from torchrbd.parameters import PARAMETERS_PER_BODY, to_log_cholesky

# Of a fit; it has settled where a round gains less than so many nats.
_MOST_ROUNDS, _STEPS, _SETTLED = 30, 40, 0.01
# Noise to start from, of a joint's torque: where the model makes the torques exactly.
_LEAST_NOISE = 1e-6


class BayesianDynamics(nn.Module):
    """A robot with a posterior over its parameters.

        bayes = BayesianDynamics.from_diagnosis(torchrbd.diagnose("robot.urdf", "monday.csv"))
        mean, parameter_std, noise_std = bayes.predict(q, qd, qdd)
        robots = bayes.sample_robots(64)              # domain randomisation: robots(q, qd, qdd), robots.step(...)

    or from scratch, with any optimiser and whatever else is in the loss:

        bayes = BayesianDynamics(RigidBodyDynamics.from_urdf("robot.urdf", effects=["viscous_friction"]))
        bayes.whiten(q, qd, qdd, tau)                 # coordinates in which all directions are as steep
        loss = -bayes.elbo(q, qd, qdd, tau) / len(q)

    States and torques are taken as exact and samples as independent; for recordings ``torchrbd.identify`` models both
    better.

    Args:
        physics: where it starts, around which the prior is, and whose bodies and terms are free; copied.
        kappa: weight of the prior's divergence from the bodies of ``physics``.
        term_std: prior standard deviation of every coefficient around its start, in its own unit; ``whiten`` sets it
            from torques.
        noise_std: (n_dof,) standard deviations of the torque to start from [N m, N]; 1 if None.
        trust: bodies that are known, by name.

    Attributes:
        mean: m (n_free,).
        raw_factor: (n_spread, n_spread) lower triangle of T, its diagonal as logarithm.
        raw_noise: (n_dof,) logarithm of sigma.
        centre: theta_0 (n,). whitening: W (n_free, n_free). spread: V (n_free, n_spread).
    """

    centre: Tensor
    whitening: Tensor
    spread: Tensor
    prior_mean: Tensor
    prior_std: Tensor
    free_bodies: Tensor
    free: Tensor
    linear: Tensor

    def __init__(
        self,
        physics: RigidBodyDynamics,
        *,
        kappa: float = KAPPA,
        term_std: float | Tensor = 1.0,
        noise_std: Tensor | None = None,
        trust: Collection[str] = (),
    ) -> None:
        super().__init__()
        robot = physics.robot
        if unknown := [name for name in trust if name not in robot.body_names]:
            raise InputError(f"trust: '{unknown[0]}' is no body of robot '{robot.name}': {', '.join(robot.body_names)}")
        self.physics, self.kappa = copy.deepcopy(physics).requires_grad_(False), kappa
        start, n_inertial = flatten(self.physics), physics.raw_inertia.numel()
        bodies = physics.physical.nonzero().flatten().tolist()
        fitted = [k for k, b in enumerate(bodies) if robot.body_names[b] not in trust]
        self.register_buffer("centre", start.clone())
        self.register_buffer("prior_mean", start.clone())
        self.register_buffer("prior_std", start.new_ones(len(start) - n_inertial) * term_std)
        # Which of the physical bodies are free; where free coordinates are in theta and in x.
        ten = torch.arange(PARAMETERS_PER_BODY)
        terms = torch.arange(len(start) - n_inertial)
        self.register_buffer("free_bodies", torch.tensor(fitted, dtype=torch.long))
        in_theta = [PARAMETERS_PER_BODY * k + ten for k in fitted]
        self.register_buffer("free", torch.cat((*in_theta, n_inertial + terms)))
        self.register_buffer("linear", linear_entries(self.physics)[self.free])
        noise = start.new_ones(robot.n_dof) if noise_std is None else noise_std.to(start)
        self.raw_noise = nn.Parameter(noise.log())
        self._start_from(
            inverse_root(self._prior_precision_of_theta()), inverse_root(self._prior_precision(self.prior_mean))
        )

    @classmethod
    def from_diagnosis(cls, result: Any) -> BayesianDynamics:
        """Take the posterior of a ``Diagnosis`` or an ``Identification``, or of the folder that a command wrote.

        Raises:
            InputError: there is none: an estimator without intervals.
        """
        if isinstance(result, (str, Path)):
            return cls.load(result)
        posterior = getattr(getattr(result, "identification", result), "posterior", None)
        model = RigidBodyDynamics.from_diagnosis(result)
        if not isinstance(posterior, Posterior):
            raise InputError(
                "this result has no posterior: its estimator gives no intervals; identify with the default one"
            )
        fit, prior = posterior.model, posterior.prior
        noise, n_inertial = fit.noise_variance.sqrt(), model.raw_inertia.numel()
        held = [name for b, name in enumerate(model.robot.body_names) if b not in prior.bodies]
        bayes = cls(model, kappa=prior.kappa, noise_std=torch.where(noise.isfinite(), noise, 1.0), trust=held)
        for k, b in zip(bayes.free_bodies.tolist(), prior.bodies, strict=True):
            own = slice(PARAMETERS_PER_BODY * b, PARAMETERS_PER_BODY * (b + 1))
            bayes.prior_mean[_of_body(k)] = to_log_cholesky(prior.mean[own])
        at = linear_positions(model, fit)
        fitted = torch.nonzero(at >= 0).flatten()
        bayes.prior_mean[n_inertial + fitted] = prior.mean[at[fitted]]
        bayes.prior_std[fitted] = prior.scale.diagonal()[at[fitted]]
        values, axes = torch.linalg.eigh(fitted_covariance(fit, torch.cat((prior.inertial, at))))
        kept = values > 0
        bayes._start_from(bayes.whitening, axes[:, kept] * values[kept].sqrt())
        return bayes

    @classmethod
    def load(cls, path: str | Path) -> BayesianDynamics:
        """Read what ``save`` wrote, or the folder of results that holds it.

        Raises:
            InputError: no such file, none of ours, or a model without a posterior.
        """
        physics, own = RigidBodyDynamics.load(path), read_model(path).posterior
        if not own:
            raise InputError(f"{path}: holds a model without a posterior; RigidBodyDynamics.load reads it")
        bodies, fitted = physics.physical.nonzero().flatten().tolist(), own["free_bodies"].tolist()
        trust = [physics.robot.body_names[b] for k, b in enumerate(bodies) if k not in fitted]
        bayes = cls(physics, kappa=float(own.pop("kappa")), trust=trust)
        bayes._start_from(own["whitening"], own["spread"])
        bayes.load_state_dict(own | {f"physics.{k}": v for k, v in physics.state_dict().items()})
        return bayes

    def __repr__(self) -> str:
        return brief(
            self,
            physics=self.physics,
            free=len(self.free),
            known_bodies=self.physics.robot.n_bodies - len(self.free_bodies),
        )

    def save(self, path: str | Path) -> None:
        """Write model and posterior to one safetensors file, which ``RigidBodyDynamics.load`` reads too.

        Raises:
            RobotError: the robot was not made from a URDF.
        """
        own = {k: v for k, v in self.state_dict().items() if not k.startswith("physics.")}
        own["kappa"] = torch.tensor(self.kappa, dtype=torch.float64)
        robot = self.robot()
        about = {"conditions": robot.conditions, "reported": robot.reported, "drives": robot.drives}
        write_model(path, robot.robot, robot.terms, robot.state_dict(), own, **about)

    @property
    def noise_std(self) -> Tensor:
        """Standard deviation of the torque around the model's (n_dof,) [N m, N]."""
        return self.raw_noise.exp()

    @property
    def theta(self) -> Tensor:
        """Mean of log-Cholesky coordinates and coefficients (n,)."""
        return self.centre.index_add(0, self.free, self.whitening @ self.mean)

    @property
    def root(self) -> Tensor:
        """R (n_free, n_spread): the free entries of x have the covariance R R'."""
        return self.spread @ (self.raw_factor.tril(-1) + torch.diag(self.raw_factor.diagonal().exp()))

    def _parameters_at(self, theta: Tensor) -> dict[str, Tensor]:
        """Return the parameters of ``physics`` at theta (*batch, n), by name."""
        return unflatten(self.physics, theta)

    def robot(self) -> RigidBodyDynamics:
        """Return a copy of the model at the mean."""
        model = copy.deepcopy(self.physics)
        model.load_state_dict(self._parameters_at(self.theta.detach()), strict=False)
        return model.requires_grad_(True)

    def forward(self, q: Tensor, qd: Tensor, qdd: Tensor, t: Tensor | None = None) -> Tensor:
        """Return the torque at the mean (*batch, n_dof); arguments as of ``RigidBodyDynamics``."""
        return torch.func.functional_call(self.physics, self._parameters_at(self.theta), (q, qd, qdd, t))

    def predict(self, q: Tensor, qd: Tensor, qdd: Tensor, t: Tensor | None = None) -> Prediction:
        """Return the torque with its uncertainty, that of the parameters and that of the noise apart."""
        spread = self._spread(q, qd, qdd, t).square().sum(-1).sqrt()
        return Prediction(self(q, qd, qdd, t), spread, self.noise_std.to(spread))

    def tau_ext(
        self, q: Tensor, qd: Tensor, qdd: Tensor, tau: Tensor, t: Tensor | None = None, *, probability: float = 0.999
    ) -> ExternalTorque:
        """Return what a measured torque has beyond the model's: contact, where it is out of the band.

        Args:
            q, qd, qdd, tau: (*batch, n_dof), filtered as the torques were that the noise is of.
            t: as of ``forward``.
            probability: that a torque without contact stays within the band.
        """
        expected = self.predict(q, qd, qdd, t)
        low, high = expected.interval(probability)
        return ExternalTorque(tau - expected.mean, expected.std, (tau < low) | (tau > high))

    def elbo(
        self,
        q: Tensor,
        qd: Tensor,
        qdd: Tensor,
        tau: Tensor,
        t: Tensor | None = None,
        *,
        n_samples: float | None = None,
    ) -> Tensor:
        """Return the evidence lower bound [nats], up to the constant of the prior.

        Args:
            q, qd, qdd, tau: (*batch, n_dof).
            t: as of ``forward``.
            n_samples: how many independent samples the batch represents: all of the data if it is a minibatch, fewer
                if noise is correlated. Default: the number of its samples.
        """
        mean = self(q, qd, qdd, t)
        variance = self.noise_std.square().to(mean)
        square = (tau - mean).square() + self._spread(q, qd, qdd, t).square().sum(-1)
        likelihood = -0.5 * (square / variance + variance.log() + math.log(2.0 * math.pi)).sum()
        scale = 1.0 if n_samples is None else n_samples / max(1, mean[..., 0].numel())
        return scale * likelihood - self.divergence()

    def divergence(self) -> Tensor:
        """Return KL(q | p) up to the prior's constant [nats]."""
        theta, root, n = self.theta, self.root, self.physics.raw_inertia.numel()
        bodies = self._bodies(theta)
        # Of the spread the curvature counts, tr(D'' R R') / 2.
        spread = root[: bodies.numel()].unflatten(0, (-1, PARAMETERS_PER_BODY))
        wide = (curvature(bodies) @ spread * spread).sum()
        energy = self.kappa * (divergence(bodies, self._bodies(self.prior_mean)).sum() + 0.5 * wide)
        square = (theta[n:] - self.prior_mean[n:]).square() + root[bodies.numel() :].square().sum(-1)
        return energy + 0.5 * (square / self.prior_std.square()).sum() - self.raw_factor.diagonal().sum()

    def whiten(self, q: Tensor, qd: Tensor, qdd: Tensor, tau: Tensor, t: Tensor | None = None) -> None:
        """Choose coordinates in which the loss of a sample is equally steep in all directions, around the mean.

            W W' = N (J'(sum_i A_i' A_i / sigma^2) J + prior curvature)^-1,   V V' = (the same in x)^-1,   J = dx/dtheta

        so that a plain gradient step on -ELBO / N is a Gauss-Newton step. Noise starts from the residual of the torque,
        and the prior of coefficients is as wide as ten times the joint's torque would make it. If the mean has moved
        far, whiten again, and give an optimiser the new parameters.

        Args:
            q, qd, qdd, tau: (*batch, n_dof), all of the data or some thousands of samples.
            t: as of ``forward``.
        """
        with torch.no_grad():
            A = self._columns(q, qd, qdd, t).flatten(0, -3).to(self.centre)
            torque, n_terms = tau.reshape(-1, tau.shape[-1]).to(self.centre), len(self.prior_std)
            sizes = felt(A[..., A.shape[-1] - n_terms :], torque)
            self.prior_std.copy_(torch.where(sizes > 0, TERM_WIDTH / sizes, 1.0))
            left = torque - self(q, qd, qdd, t).reshape(torque.shape)
            std = torch.maximum(left.square().mean(0).sqrt(), _LEAST_NOISE * torque.square().mean(0).sqrt())
            std = torch.where(std > 0, std, 1.0)
            self.raw_noise.copy_(std.log())
            A = A / std.unsqueeze(-1)
            H, J = torch.einsum("bdk,bdl->kl", A, A), slopes(self.physics, self._parameters_at(self.theta), self.free)
            whitening = len(A) ** 0.5 * inverse_root(J.T @ H @ J + self._prior_precision_of_theta())
            self._start_from(whitening, inverse_root(H + self._prior_precision(self.theta)))

    def fit(
        self,
        q: Tensor,
        qd: Tensor,
        qdd: Tensor,
        tau: Tensor,
        t: Tensor | None = None,
        *,
        n_samples: float | None = None,
    ) -> None:
        """Maximise the ELBO of all data by autograd: L-BFGS in coordinates that are whitened anew each round.

        Args:
            q, qd, qdd, tau, t, n_samples: as of ``elbo``.
        """
        for _ in range(_MOST_ROUNDS):
            self.whiten(q, qd, qdd, tau, t)
            free = [p for p in self.parameters() if p.requires_grad]
            optimiser = torch.optim.LBFGS(free, max_iter=_STEPS, line_search_fn="strong_wolfe")

            def loss() -> float:
                optimiser.zero_grad()  # noqa: B023
                found = -self.elbo(q, qd, qdd, tau, t, n_samples=n_samples) / len(q)
                found.backward()
                return float(found.detach())

            # Rounds cannot be compared: the bound is that of a model that is linearised anew in each.
            before = loss()
            optimiser.step(loss)
            if (before - loss()) * len(q) < _SETTLED:
                return

    def sample_robots(self, n: int, seed: int = 0) -> ManyRobots:
        """Draw robots as probable as the posterior says, all of them physical, as one module.

        The likelihood is Gaussian in x, the prior the entropic one itself, so that no body is without mass.

        Args:
            n: how many.
            seed: of the random numbers.

        Raises:
            InputError: n is not positive.
        """
        with torch.no_grad():
            theta, root = self.theta, self.root.cpu()
            x = linear(self.physics, theta).cpu()
            mean, precision = linear(self.physics, self.prior_mean), self._prior_precision(self.prior_mean)
            prior = as_prior(mean.cpu(), self.linear.cpu(), precision.cpu(), len(self.free_bodies), self.kappa)
            drawn = sample_around(prior, x, self.linear.cpu(), root @ root.T, n, seed).x.to(theta)
            found = theta.repeat(n, 1)
            found[:, self.free] = drawn[:, self.linear]
            for place, k in enumerate(self.free_bodies.tolist()):
                found[:, _of_body(k)] = to_log_cholesky(drawn[:, self.linear[_of_body(place)]])
            return ManyRobots(self.robot(), self._parameters_at(found))

    def _columns(self, q: Tensor, qd: Tensor, qdd: Tensor, t: Tensor | None) -> Tensor:
        """Return A (*batch, n_dof, n_free) of the free entries of x, at the mean."""
        with torch.autocast(q.device.type, enabled=False):
            A = physics_columns(self.physics, q, qd, qdd, t, parameters=self._parameters_at(self.theta))
            return A[..., self.linear]

    def _spread(self, q: Tensor, qd: Tensor, qdd: Tensor, t: Tensor | None) -> Tensor:
        """Return A R (*batch, n_dof, n_spread)."""
        A = self._columns(q, qd, qdd, t)
        with torch.autocast(q.device.type, enabled=False):
            return A @ self.root.to(A)

    def _start_from(self, whitening: Tensor, spread: Tensor) -> None:
        """Take the mean for the centre, other coordinates around it, and R = V."""
        if hasattr(self, "mean"):
            self.centre = self.theta.detach().clone()
        self.register_buffer("whitening", whitening.to(self.centre))
        self.register_buffer("spread", spread.to(self.centre))
        self.mean = nn.Parameter(self.centre.new_zeros(whitening.shape[1]))
        self.raw_factor = nn.Parameter(self.centre.new_zeros(spread.shape[1], spread.shape[1]))

    def _bodies(self, theta: Tensor) -> Tensor:
        """Return the coordinates of the free bodies, (n_bodies, 10)."""
        return theta[: self.physics.raw_inertia.numel()].reshape(-1, PARAMETERS_PER_BODY)[self.free_bodies]

    def _prior_precision(self, theta: Tensor) -> Tensor:
        """Return the prior's curvature in the free entries of x, at theta (n,)."""
        bodies = self.kappa * curvature(self._bodies(theta))
        return torch.block_diag(*bodies, torch.diag(self.prior_std**-2.0))

    def _prior_precision_of_theta(self) -> Tensor:
        """Return the same in the free entries of theta, at the prior's mode, where D has no slope."""
        J = slopes(self.physics, self._parameters_at(self.prior_mean), self.free)
        return J.T @ self._prior_precision(self.prior_mean) @ J


def _of_body(k: int) -> slice:
    """Return where the ten numbers of body k are."""
    return slice(PARAMETERS_PER_BODY * k, PARAMETERS_PER_BODY * (k + 1))
