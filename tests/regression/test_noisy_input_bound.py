"""The noisy-input model's bound against integration over all that is hidden, and its gradient."""

from __future__ import annotations

import math

import pytest
import torch
from regression.regressions import noisy_inputs, normal
from torch import Tensor
from torch.distributions import Gamma, InverseGamma, Normal, kl_divergence

from torchrbd.regression.moments import Moments
from torchrbd.regression.noisy_input.elbo import Evidence, NoisePrior, Posterior, Priors, elbo

PRIORS = Priors(0.7, 0.4, NoisePrior(1.5, 0.2), NoisePrior(1.2, 0.3), NoisePrior(2.5, 0.1))


def random_posterior(d: int, seed: int, *, merged: bool) -> Posterior:
    positive = normal(seed, 5, d).mul(0.7).exp()
    x_mean, z_mean = normal(seed + 1, 2, d)
    hidden = None if merged else 0.2 * positive[4]
    return Posterior(x_mean, positive[0], z_mean, positive[1], positive[2], positive[3], hidden, positive[4, 0])


def dense_elbo(X: Tensor, y: Tensor, s: Posterior) -> Tensor:
    """Integrate exp E_q(w)[log p(y, x, z, t | w)] over z and t row by row, as a Gaussian of 2 d (or d) dimensions."""
    d = X.shape[1]
    total = X.new_zeros(())
    xx, zz = s.x_mean**2 + s.x_var, s.z_mean**2 + s.z_var
    for x, target in zip(X, y, strict=True):
        if s.hidden_noise is None:
            A = torch.diag(1.0 + xx / s.input_noise + s.z_var / s.output_noise)
            A = A + torch.outer(s.z_mean, s.z_mean) / s.output_noise
            b = s.x_mean * x / s.input_noise + s.z_mean * target / s.output_noise
            constant = -0.5 * d * math.log(2.0 * math.pi)
        else:
            to_z = torch.diag(-s.z_mean / s.hidden_noise)
            of_z = torch.diag(1.0 / s.hidden_noise) + torch.ones(d, d).double() / s.output_noise
            of_t = torch.diag(1.0 + xx / s.input_noise + zz / s.hidden_noise)
            A = torch.cat((torch.cat((of_z, to_z), 1), torch.cat((to_z, of_t), 1)), 0)
            b = torch.cat((torch.ones(d).double() * target / s.output_noise, s.x_mean * x / s.input_noise))
            constant = -d * math.log(2.0 * math.pi) - 0.5 * s.hidden_noise.log().sum()
        constant = constant - 0.5 * (2.0 * math.pi * s.output_noise).log() - 0.5 * target**2 / s.output_noise
        constant = constant - 0.5 * ((2.0 * math.pi * s.input_noise).log() + x**2 / s.input_noise).sum()
        integral = 0.5 * (len(b) * math.log(2.0 * math.pi) - torch.logdet(A) + b @ torch.linalg.solve(A, b))
        total = total + constant + integral
    return total


def dense_divergence(s: Posterior) -> Tensor:
    """KL of q(w) q(alpha), from torch.distributions; E_q(alpha) of log N(w; 0, 1/alpha) by hand."""
    q_alpha = Gamma(torch.full_like(s.rate, PRIORS.shape + 1.0), s.rate)
    divergence = kl_divergence(
        q_alpha, Gamma(torch.tensor(PRIORS.shape, dtype=torch.float64), torch.tensor(PRIORS.rate, dtype=torch.float64))
    )
    mean_log = torch.digamma(q_alpha.concentration) - s.rate.log()
    for mean, var in ((s.x_mean, s.x_var), (s.z_mean, s.z_var)):
        expected = 0.5 * (mean_log - math.log(2.0 * math.pi) - q_alpha.mean * (mean**2 + var))
        divergence = divergence - expected - Normal(mean, var.sqrt()).entropy()
    return divergence.sum()


def log_inverse_gamma(psi: Tensor, prior: NoisePrior) -> Tensor:
    distribution = InverseGamma(
        torch.tensor(prior.shape, dtype=torch.float64), torch.tensor(prior.scale, dtype=torch.float64)
    )
    return distribution.log_prob(psi).sum()


@pytest.mark.parametrize("merged", [True, False])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_bound_is_that_of_dense_integration(merged: bool, seed: int) -> None:
    X, y = noisy_inputs(seed, n=7)
    s = random_posterior(3, seed + 100, merged=merged)
    expected = dense_elbo(X, y, s) - dense_divergence(s)
    expected = expected + log_inverse_gamma(s.input_noise, NoisePrior(1.5, 0.2))
    expected = expected + log_inverse_gamma(s.output_noise, NoisePrior(2.5, 0.1))
    if s.hidden_noise is not None:
        expected = expected + log_inverse_gamma(s.hidden_noise, NoisePrior(1.2, 0.3))
    moments = Moments.from_data(X, y)
    got = elbo(Evidence(moments.xx, moments.xy, moments.yy, moments.n), PRIORS, s)
    assert float(got) == pytest.approx(float(expected), rel=1e-11)


@pytest.mark.parametrize("merged", [True, False])
def test_bound_gradient(merged: bool) -> None:
    X, y = noisy_inputs(11, n=9)
    moments = Moments.from_data(X, y)
    evidence = Evidence(moments.xx, moments.xy, moments.yy, moments.n)
    s = random_posterior(3, 12, merged=merged)
    fields = (s.x_mean, s.x_var, s.z_mean, s.z_var, s.rate, s.input_noise, s.output_noise)
    fields = fields if s.hidden_noise is None else (*fields, s.hidden_noise)

    def value(*v: Tensor) -> Tensor:
        return elbo(
            evidence, PRIORS, Posterior(v[0], v[1], v[2], v[3], v[4], v[5], v[7] if len(v) == 8 else None, v[6])
        )

    assert torch.autograd.gradcheck(value, [f.clone().requires_grad_() for f in fields])
