"""The posterior of a robot as a module: torques with their uncertainty, robots to train with, and a loss.

A Gaussian q over theta, the log-Cholesky coordinates of the bodies and the coefficients of the terms,

    theta = theta_0 + W u,   u ~ N(m, T T')

is fitted by autograd to the evidence lower bound of independent samples,

    ELBO = sum_ij E_q log N(tau_ij | tau_j(x_i; theta), sigma_j^2) - KL(q | p)
    E_q (tau - tau(theta))^2 = (tau - tau(mean))^2 + A Cov A',       A = dtau / dtheta at the mean

which is exact where the torque is linear in what is free. The prior p(theta) ~ exp(-kappa D(J(theta) | J_URDF)) has the
entropic divergence that ``identify`` has, so that where data are many the mean is the convex fit's.

Sources: Ting, Mistry, Peters, Schaal, Nakanishi, "A Bayesian Approach to Nonlinear Parameter Identification for Rigid
    Body Dynamics", RSS 2006, for variational inference of these parameters (of inputs without noise here).
"""

from __future__ import annotations

import copy
import math
from collections.abc import Collection
from pathlib import Path
from typing import Any, NamedTuple

import torch
from scipy.stats import norm
from torch import Tensor, nn

from torchrbd.errors import InputError
from torchrbd.inference.posterior.posterior import Posterior
from torchrbd.learning.body_prior import curvature, expected_divergence
from torchrbd.learning.coordinates import flatten, in_log_cholesky, positions, rows, unflatten
from torchrbd.learning.many_robots import ManyRobots
from torchrbd.likelihood.urdf_prior import KAPPA, TERM_WIDTH, Prior
from torchrbd.model import RigidBodyDynamics
from torchrbd.model.files import POSTERIOR, read_model, write_model
from torchrbd.parameters import PARAMETERS_PER_BODY, to_log_cholesky

# Of a fit; it has settled where a round gains less than so many nats.
_MOST_ROUNDS, _STEPS, _SETTLED = 30, 15, 0.01


class Prediction(NamedTuple):
    """A torque and how sure it is, [N m] or [N].

    Attributes:
        mean: (*batch, n_dof).
        parameter_std: (*batch, n_dof) from what is not known of the parameters.
        noise_std: (n_dof,) of what the model does not explain of a measured torque.
    """

    mean: Tensor
    parameter_std: Tensor
    noise_std: Tensor

    @property
    def std(self) -> Tensor:
        """Of a torque that is measured, (*batch, n_dof)."""
        return (self.parameter_std.square() + self.noise_std.square()).sqrt()

    def interval(self, probability: float = 0.95) -> tuple[Tensor, Tensor]:
        """Return the ends of an interval that holds a measured torque with this probability."""
        width = float(norm.ppf(0.5 + 0.5 * probability)) * self.std
        return self.mean - width, self.mean + width


class ExternalTorque(NamedTuple):
    """What a measured torque has beyond the model's, [N m] or [N].

    Attributes:
        torque, std: (*batch, n_dof), and its standard deviation where nothing touches the robot.
        touched: (*batch, n_dof) whether it is out of the band of that.
    """

    torque: Tensor
    std: Tensor
    touched: Tensor


class BayesianDynamics(nn.Module):
    """A robot that knows how well it is known.

        bayes = BayesianDynamics.from_diagnosis(torchrbd.diagnose("robot.urdf", "monday.csv"))
        mean, parameter_std, noise_std = bayes.predict(q, qd, qdd)
        robots = bayes.sample_robots(64)              # domain randomisation: robots(q, qd, qdd), robots.step(...)

    or from scratch, with any optimiser and whatever else is in the loss:

        bayes = BayesianDynamics(RigidBodyDynamics.from_urdf("robot.urdf", effects=["viscous_friction"]))
        bayes.whiten(q, qd, qdd, tau)                 # coordinates in which all directions are as steep
        loss = -bayes.elbo(q, qd, qdd, tau)

    Args:
        physics: where it starts, around which the prior is, and whose bodies and terms are free; copied.
        kappa: weight of the prior's divergence from the bodies of ``physics``.
        term_std: prior standard deviation of every coefficient around its start, in its own unit; ``whiten`` tells it
            from torques, before that it is 1.
        noise_std: (n_dof,) standard deviations of the torque to start from [N m, N].
        trust: bodies that are known, by name.

    Attributes:
        mean: m (n_free,).
        raw_factor: (n_free, n_free) lower triangle of T, its diagonal as logarithm.
        raw_noise: (n_dof,) logarithm of sigma.
        centre: theta_0 (n,). whitening: W (n, n_free).
    """

    centre: Tensor
    whitening: Tensor
    prior_mean: Tensor
    prior_std: Tensor

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
        start, n_bodies = flatten(self.physics), len(self.physics.raw_inertia)
        n_inertial = n_bodies * PARAMETERS_PER_BODY
        names = [
            name for name, physical in zip(robot.body_names, self.physics.physical.tolist(), strict=True) if physical
        ]
        self._free_bodies = tuple(k for k, name in enumerate(names) if name not in trust)
        self.register_buffer("centre", start.clone())
        self.register_buffer("prior_mean", start.clone())
        # Of bodies it is the divergence's curvature that counts.
        std = torch.cat((start.new_ones(n_inertial), start.new_ones(len(start) - n_inertial) * term_std))
        self.register_buffer("prior_std", std)
        wide = torch.linalg.inv(torch.linalg.cholesky(self._prior_precision())).mT
        whitening = start.new_zeros(len(start), len(wide))
        whitening[self._free()] = wide
        self.register_buffer("whitening", whitening)
        self.mean = nn.Parameter(start.new_zeros(wide.shape[1]))
        self.raw_factor = nn.Parameter(start.new_zeros(wide.shape[1], wide.shape[1]))
        noise = start.new_ones(robot.n_dof) if noise_std is None else noise_std.to(start)
        self.raw_noise = nn.Parameter(noise.log())

    @classmethod
    def from_diagnosis(cls, result: Any) -> BayesianDynamics:
        """Take the posterior of a ``Diagnosis`` or an ``Identification``, or of the folder that a command wrote.

        Raises:
            InputError: there is none: an estimator without intervals.
        """
        if isinstance(result, (str, Path)):
            return cls.load(result)
        found = getattr(result, "identification", result)
        posterior, model = getattr(found, "posterior", None), RigidBodyDynamics.from_diagnosis(result)
        if not isinstance(posterior, Posterior):
            raise InputError(
                "this result has no posterior: its estimator gives no intervals; identify with the default"
            )
        fit, prior = posterior.model, posterior.prior
        noise, index = fit.noise_variance.sqrt(), positions(model, fit)
        held = [name for b, name in enumerate(model.robot.body_names) if b not in prior.bodies]
        known = torch.where(noise.isfinite(), noise, 1.0)
        bayes = cls(model, kappa=prior.kappa, noise_std=known, trust=held)
        bayes._believe(prior, index)
        values, axes = torch.linalg.eigh(in_log_cholesky(model, fit, index))
        kept = values > 1e-14 * values.max()
        bayes._start_from(axes[:, kept] * values[kept].sqrt())
        return bayes

    @classmethod
    def load(cls, path: str | Path) -> BayesianDynamics:
        """Read what ``save`` wrote, or the folder of results that holds it.

        Raises:
            InputError: no such file, none of ours, or a model without a posterior.
        """
        robot, pi, terms, state = read_model(path)
        own = {k.removeprefix(POSTERIOR): v for k, v in state.items() if k.startswith(POSTERIOR)}
        if not own:
            raise InputError(f"{path}: holds a model without a posterior; RigidBodyDynamics.load reads it")
        physics = RigidBodyDynamics(robot, pi, terms)
        physics.load_state_dict({k: v for k, v in state.items() if not k.startswith(POSTERIOR)})
        bayes = cls(physics, kappa=float(own.pop("kappa")))
        bayes._start_from(own["whitening"])
        own |= {f"physics.{k}": v for k, v in physics.state_dict().items()}
        bayes.load_state_dict(own)
        return bayes

    def save(self, path: str | Path) -> None:
        """Write model and posterior to one safetensors file, which ``RigidBodyDynamics.load`` reads too.

        Raises:
            RobotError: the robot was not made from a URDF.
        """
        own = {k: v for k, v in self.state_dict().items() if not k.startswith("physics.")}
        posterior = {POSTERIOR + k: v for k, v in own.items()} | {f"{POSTERIOR}kappa": torch.tensor(self.kappa)}
        robot = self.robot()
        write_model(path, robot.robot, robot.terms, robot.state_dict() | posterior)

    @property
    def noise_std(self) -> Tensor:
        """Standard deviation of the torque beside the model's (n_dof,) [N m, N]."""
        return self.raw_noise.exp()

    @property
    def theta(self) -> Tensor:
        """Mean of log-Cholesky coordinates and coefficients (n,)."""
        return self.centre + self.whitening @ self.mean

    @property
    def root(self) -> Tensor:
        """Their covariance's root (n, n_free): theta ~ N(mean, root root')."""
        factor = self.raw_factor.tril(-1) + torch.diag(self.raw_factor.diagonal().exp())
        return self.whitening @ factor

    def robot(self) -> RigidBodyDynamics:
        """Return a copy of the model at the mean."""
        model = copy.deepcopy(self.physics)
        model.load_state_dict(unflatten(model, self.theta.detach()), strict=False)
        return model.requires_grad_(True)

    def forward(self, q: Tensor, qd: Tensor, qdd: Tensor, t: Tensor | None = None) -> Tensor:
        """Return the torque at the mean (*batch, n_dof); arguments as of ``RigidBodyDynamics``."""
        return torch.func.functional_call(self.physics, unflatten(self.physics, self.theta), (q, qd, qdd, t))

    def predict(self, q: Tensor, qd: Tensor, qdd: Tensor, t: Tensor | None = None) -> Prediction:
        """Return the torque with its uncertainty, that of the parameters and that of the noise apart."""
        with torch.autocast(q.device.type, enabled=False):
            mean, spread = self._spread(q, qd, qdd, t)
        return Prediction(mean, spread.square().sum(-1).sqrt(), self.noise_std.to(mean))

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
            n_samples: how many independent samples the batch stands for: all of the data where it is a minibatch,
                fewer than there are where noise is correlated; its own number by default.
        """
        mean, spread = self._spread(q, qd, qdd, t)
        variance = self.noise_std.square().to(mean)
        square = (tau - mean).square() + spread.square().sum(-1)
        likelihood = -0.5 * (square / variance + variance.log() + math.log(2.0 * math.pi)).sum()
        count = max(1, mean[..., 0].numel())
        scale = 1.0 if n_samples is None else n_samples / count
        return scale * likelihood - self.divergence()

    def divergence(self) -> Tensor:
        """Return KL(q | p) up to the prior's constant [nats]."""
        theta, root = self.theta, self.root
        n = self.physics.raw_inertia.numel()
        energy = theta.new_zeros(())
        for k in self._free_bodies:
            own = _of_body(k)
            energy = energy + expected_divergence(theta[own], root[own], self.prior_mean[own])
        std = self.prior_std[n:]
        spread = (theta[n:] - self.prior_mean[n:]).square() + root[n:].square().sum(-1)
        energy = self.kappa * energy + 0.5 * (spread / std.square()).sum()
        return energy - self.raw_factor.diagonal().sum()

    def whiten(self, q: Tensor, qd: Tensor, qdd: Tensor, tau: Tensor, t: Tensor | None = None) -> None:
        """Choose coordinates in which the loss of a sample is as steep in all directions, around the mean.

            W W' = N (sum_i A_i' A_i / sigma^2 + prior curvature)^-1,   T = 1 / sqrt(N)

        so that a plain gradient step on -ELBO / N is a Gauss-Newton step. Noise starts from what is left of the torque,
        and the prior of coefficients is as wide as ten times the joint's torque would make it. Curvature is that of the
        mean: where the mean has gone far, whiten again, and give an optimiser the new parameters.

        Args:
            q, qd, qdd, tau: (*batch, n_dof), all of the data or some thousands of samples.
            t: as of ``forward``.
        """
        with torch.no_grad():
            A = rows(self.physics, unflatten(self.physics, self.theta), q, qd, qdd, t).flatten(0, -3).to(self.centre)
            n, free = self.physics.raw_inertia.numel(), self._free()
            torque = tau.reshape(-1, tau.shape[-1]).to(self.centre)
            felt = (A[..., n:].square().mean(0).sqrt() / torque.square().mean(0).sqrt().unsqueeze(-1)).amax(0)
            self.prior_std[n:] = torch.where(felt > 0, TERM_WIDTH / felt, 1.0)
            std = (torque - self(q, qd, qdd, t).reshape(torque.shape)).square().mean(0).sqrt()
            self.raw_noise.copy_(std.log())
            weighed = A[..., free] / std.unsqueeze(-1)
            precision = torch.einsum("bdk,bdl->kl", weighed, weighed) + self._prior_precision()
            values, axes = torch.linalg.eigh(precision / len(A))
            whitening = self.centre.new_zeros(len(self.centre), len(free))
            whitening[free] = axes / values.sqrt()
            self._start_from(whitening, len(A) ** -0.5)

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
        before = -math.inf
        for _ in range(_MOST_ROUNDS):
            self.whiten(q, qd, qdd, tau, t)
            optimiser = torch.optim.LBFGS(
                [p for p in self.parameters() if p.requires_grad], max_iter=_STEPS, line_search_fn="strong_wolfe"
            )

            def loss() -> float:
                optimiser.zero_grad()  # noqa: B023
                found = -self.elbo(q, qd, qdd, tau, t, n_samples=n_samples) / len(q)
                found.backward()
                return float(found.detach())

            optimiser.step(loss)
            now = float(self.elbo(q, qd, qdd, tau, t, n_samples=n_samples).detach())
            if now - before < _SETTLED:
                return
            before = now

    def sample_robots(self, n: int, seed: int = 0) -> ManyRobots:
        """Draw robots as probable as the posterior says, all of them physical, as one module.

        Args:
            n: how many.
            seed: of the random numbers.

        Raises:
            InputError: n is not positive.
        """
        if n < 1:
            raise InputError(f"n is {n}, expected at least 1")
        generator = torch.Generator().manual_seed(seed)
        e = torch.randn(n, len(self.mean), generator=generator, dtype=torch.float64).to(self.centre)
        theta = (self.theta + e @ self.root.T).detach()
        return ManyRobots(self.robot(), unflatten(self.physics, theta))

    def _spread(self, q: Tensor, qd: Tensor, qdd: Tensor, t: Tensor | None) -> tuple[Tensor, Tensor]:
        """Return the torque at the mean, and A root (*batch, n_dof, n_free)."""
        parameters = unflatten(self.physics, self.theta)
        mean = torch.func.functional_call(self.physics, parameters, (q, qd, qdd, t))
        return mean, rows(self.physics, parameters, q, qd, qdd, t) @ self.root.to(mean)

    def _believe(self, prior: Prior, index: Tensor) -> None:
        """Take the prior of a fit, whose coefficients stand at ``index`` in theta; what it has not fitted is known."""
        n = self.physics.raw_inertia.numel()
        for k in self._free_bodies:
            self.prior_mean[_of_body(k)] = to_log_cholesky(prior.mean[index[_of_body(k)]])
        told = torch.nonzero(index[n:] >= 0).flatten()
        self.prior_mean[n + told] = prior.mean[index[n + told]]
        self.prior_std[n + told] = prior.scale.diagonal()[index[n + told]]

    def _start_from(self, whitening: Tensor, size: float = 1.0) -> None:
        """Take the mean for the centre and ``size`` W for its root."""
        self.centre = self.theta.detach().clone()
        self.whitening = whitening.to(self.centre)
        n = whitening.shape[1]
        self.mean = nn.Parameter(self.centre.new_zeros(n))
        self.raw_factor = nn.Parameter(torch.diag(self.centre.new_full((n,), math.log(size))))

    def _free(self) -> Tensor:
        """Return where in theta the free coordinates are: those of the bodies, then all coefficients."""
        n, own = self.physics.raw_inertia.numel(), torch.arange(PARAMETERS_PER_BODY)
        bodies = [PARAMETERS_PER_BODY * k + own for k in self._free_bodies]
        return torch.cat((*bodies, torch.arange(n, len(self.centre))))

    def _prior_precision(self) -> Tensor:
        """Return the prior's curvature in the free coordinates, at its mode."""
        n = self.physics.raw_inertia.numel()
        bodies = [self.kappa * curvature(self.prior_mean[_of_body(k)]) for k in self._free_bodies]
        return torch.block_diag(*bodies, torch.diag(self.prior_std[n:] ** -2.0))


def _of_body(k: int) -> slice:
    """Return where the coordinates of a physical body are in theta."""
    return slice(PARAMETERS_PER_BODY * k, PARAMETERS_PER_BODY * (k + 1))
