"""What the noisy-input model's likelihood cannot identify, as its docstring says."""

from __future__ import annotations

import pytest
import torch
from regression.regressions import noisy_inputs, normal
from torch import Tensor

from torchrbd.regression.moments import Moments
from torchrbd.regression.noisy_input import NoisyInputRegression
from torchrbd.regression.noisy_input.elbo import Evidence, Posterior, Priors, collapse, elbo


def point_weights(c: Tensor, rho: Tensor, S: Tensor) -> Posterior:
    """Return weights without uncertainty with noisy-query coefficients c and residual variance S."""
    psi_x, nearly_none = 1.0 - rho, torch.full_like(c, 1e-30)
    output = S - (c.square() * psi_x / rho).sum()
    return Posterior(rho.sqrt(), nearly_none, c / rho.sqrt(), nearly_none, torch.ones_like(c), psi_x, None, output)


def evidence_of(X: Tensor, y: Tensor) -> Evidence:
    X, y = X / X.square().mean(0).sqrt(), y / y.square().mean().sqrt()
    moments = Moments.from_data(X, y)
    return Evidence(moments.xx, moments.xy, moments.yy, moments.n)


def log_likelihood(evidence: Evidence, s: Posterior) -> Tensor:
    """The bound's part that depends on the data; exact for weights without uncertainty."""
    none = Priors(1.0, 1.0, None, None, None)
    return elbo(evidence, none, s) - elbo(Evidence(evidence.xx, evidence.xy, evidence.yy, 0.0), none, s)


def test_likelihood_is_flat_in_rho_until_output_noise_is_used_up() -> None:
    evidence = evidence_of(*noisy_inputs(91, n=500, d=4))
    c = torch.linalg.solve(evidence.xx, evidence.xy)
    S = evidence.yy - c @ evidence.xy
    reference = point_weights(c, torch.full((4,), 0.98).double(), S)
    for seed in range(20):
        rho = 0.9 + 0.09 * torch.rand(4, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
        s = point_weights(c, rho, S)
        assert float(s.output_noise) > 0.0
        assert float(log_likelihood(evidence, s)) == pytest.approx(float(log_likelihood(evidence, reference)), abs=1e-8)
        b = s.z_mean / s.x_mean
        torch.testing.assert_close(b, c / rho)
    assert float(point_weights(c, torch.full((4,), 0.02).double(), S).output_noise) < 0.0


def test_noisy_query_likelihood_is_highest_at_least_squares() -> None:
    evidence = evidence_of(*noisy_inputs(101, n=500, d=4))
    ols = torch.linalg.solve(evidence.xx, evidence.xy)
    c = ols.clone().requires_grad_()
    S = (evidence.yy - ols @ evidence.xy).requires_grad_()
    rho = torch.full((4,), 0.97).double().requires_grad_()
    gradient = torch.autograd.grad(log_likelihood(evidence, point_weights(c, rho, S)), (c, S, rho))
    assert max(float(g.abs().max()) for g in gradient) < 1e-7
    best = float(log_likelihood(evidence, point_weights(ols, rho.detach(), S.detach())))
    for seed in range(5):
        moved = point_weights(ols + 0.01 * normal(seed, 4), rho.detach(), S.detach())
        assert float(log_likelihood(evidence, moved)) < best


def test_given_noise_is_right_for_independent_and_wrong_for_redundant_inputs() -> None:
    n, d, snr = 200_000, 5, 2.0
    T, b = normal(111, n, d), normal(112, d)
    y = T @ b + 0.3 * normal(113, n)
    noise = torch.full((d,), 1.0 / snr).double()
    independent = NoisyInputRegression(input_noise=noise).fit(T + noise.sqrt() * normal(114, n, d), y)

    def error(found: Tensor) -> float:
        return float((T @ (found - b)).square().mean())

    torch.testing.assert_close(independent.coefficients, b, rtol=0.0, atol=0.02)
    ols = NoisyInputRegression(noise_share=1e-4).fit(T + noise.sqrt() * normal(114, n, d), y)
    assert error(ols.coefficients) > 20.0 * error(independent.coefficients)
    # Twenty noisy copies of one input: together they are nearly noiseless, and 1 / rho = 1.5 is too much.
    copies = T[:20_000, :1].expand(-1, 20)
    X = copies + (1.0 / snr) ** 0.5 * normal(115, 20_000, 20)
    given = NoisyInputRegression(input_noise=1.0 / snr).fit(X, T[:20_000, 0]).coefficients
    least_squares = torch.linalg.lstsq(X, T[:20_000, 0]).solution
    assert float(least_squares.sum()) == pytest.approx(1.0, abs=0.05)
    assert float(given.sum()) > 1.2


def test_collapsed_coefficients_are_a_least_squares_fit_where_noise_is_noisy_inputs() -> None:
    X, y = noisy_inputs(131, n=5000)
    fitted = NoisyInputRegression(noise_share=1e-4, tolerance=1e-9).fit(X, y)
    ols = torch.linalg.lstsq(X, y).solution
    torch.testing.assert_close(fitted.noisy_coefficients, ols, rtol=0.0, atol=2e-3)
    assert bool(collapse(fitted._data, fitted.posterior).S > 0.0)
