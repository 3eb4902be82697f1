"""ARD, EIV-ARD and the factor regression: independent references, consistency, and what no data can tell."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from regression.regressions import normal, problem, with_factors
from sklearn.decomposition import FactorAnalysis
from sklearn.linear_model import ARDRegression

from torchrbd.errors import OptionError
from torchrbd.regression import (
    EIVARD,
    FactorRegression,
    Moments,
    OrdinaryLeastSquares,
    Stepwise,
)
from torchrbd.regression.ard import ard
from torchrbd.regression.factor_model import choose_rank, fit_factors


def noiseless_error(found: torch.Tensor, b: torch.Tensor, S: torch.Tensor) -> float:
    return float((found - b) @ S @ (found - b) / (b @ S @ b))


@pytest.mark.parametrize("seed", [0, 20])
def test_ard_is_sklearns(seed: int) -> None:
    X = normal(seed, 300, 5)
    y = X @ torch.tensor([2.0, 0.5, -1.0, 0.3, 1.0], dtype=torch.float64) + normal(seed + 1, 300)
    flat = {"alpha_1": 0.0, "alpha_2": 0.0, "lambda_1": 0.0, "lambda_2": 0.0}
    sklearn = ARDRegression(fit_intercept=False, tol=1e-10, max_iter=1000, **flat).fit(X.numpy(), y.numpy())
    moments = Moments.from_data(X, y)
    found = ard(moments.xx, moments.xy, float(moments.yy), moments.n)
    np.testing.assert_allclose(found.mean, sklearn.coef_, rtol=1e-3)
    np.testing.assert_allclose(found.covariance, sklearn.sigma_, rtol=1e-2, atol=1e-6)
    assert found.noise == pytest.approx(1.0 / sklearn.alpha_, rel=1e-3)


def test_ard_removes_irrelevant_columns() -> None:
    X, b = normal(30, 2000, 40), torch.cat((torch.ones(3), torch.zeros(37))).double()
    moments = Moments.from_data(X, X @ b + normal(31, 2000))
    found = ard(moments.xx, moments.xy, float(moments.yy), moments.n)
    assert bool((found.mean[:3] - 1.0).abs().max() < 0.1)
    assert int((found.mean[3:] == 0.0).sum()) >= 20
    assert bool((found.covariance.diagonal()[found.mean == 0.0] == 0.0).all())


def test_ard_intervals_cover() -> None:
    inside = []
    for seed in range(25):
        X, b = normal(100 + seed, 80, 4), normal(200 + seed, 4).sign()
        moments = Moments.from_data(X, X @ b + 0.5 * normal(300 + seed, 80))
        found = ard(moments.xx, moments.xy, float(moments.yy), moments.n)
        inside += ((found.mean - b).abs() < 1.96 * found.covariance.diagonal().sqrt()).tolist()
    assert 0.88 < np.mean(inside) < 1.0


def test_without_input_noise_it_is_plain_ard() -> None:
    moments = Moments.from_data(*problem(40))
    plain = ard(moments.xx, moments.xy, float(moments.yy), moments.n)
    found = EIVARD(torch.zeros(6)).fit(moments)
    assert torch.allclose(found.coefficients, plain.mean, rtol=1e-5)
    assert torch.allclose(found.covariance, plain.covariance, rtol=1e-4, atol=1e-9)


@pytest.mark.parametrize("correlated", [False, True])
def test_consistent_where_least_squares_is_not(correlated: bool) -> None:
    n, mix = 100_000, normal(51, 4, 4)
    clean, b = normal(50, n, 4) @ mix, normal(52, 4)
    root = 0.7 * (normal(53, 4, 4) if correlated else torch.eye(4, dtype=torch.float64))
    Psi = root @ root.T
    X, y = clean + normal(54, n, 4) @ root.T, clean @ b + normal(55, n)
    S = mix.T @ mix
    found = EIVARD(Psi if correlated else Psi.diagonal()).fit(X, y).coefficients
    assert noiseless_error(found, b, S) < 2e-3
    assert noiseless_error(OrdinaryLeastSquares().fit(X, y).coefficients, b, S) > 1e-2


def test_factor_regression_is_consistent_where_inputs_follow_a_factor_model() -> None:
    X, y, noise, b = with_factors(50, 50_000, factors=2, shared=8, single=4, snr=1.0)
    S = torch.block_diag(normal(50, 2, 8).T @ normal(50, 2, 8), torch.eye(4, dtype=torch.float64))
    assert noiseless_error(FactorRegression(noise).fit(X, y).coefficients, b, S) < 2e-3
    assert noiseless_error(OrdinaryLeastSquares().fit(X, y).coefficients, b, S) > 1e-2


def test_noisy_coefficients_predict_from_noisy_inputs() -> None:
    """Asymptotically the best prediction from noisy inputs is that of least squares."""
    X, y, noise, _ = with_factors(60, 50_000, factors=3, shared=8, single=4, snr=2.0)
    best = OrdinaryLeastSquares().fit(X, y)
    for method in (EIVARD(noise), FactorRegression(noise), FactorRegression()):
        difference = X @ (method.fit(X, y).noisy_coefficients - best.coefficients)
        assert float(difference.square().mean()) < 2e-3 * float(y.var())
    assert torch.equal(best.noisy_coefficients, best.coefficients)


@pytest.mark.parametrize("rank", [1, 3])
def test_factors_are_as_likely_as_sklearns(rank: int) -> None:
    X, y, _, _ = with_factors(70, 400, factors=3, shared=8, single=4, snr=2.0)
    X = X - X.mean(0)
    sklearn = FactorAnalysis(rank, tol=1e-8, max_iter=5000).fit(X.numpy())
    C = Moments.from_data(X, y).xx
    model = fit_factors(C, rank, torch.zeros(12, 12, dtype=torch.float64), tolerance=1e-8).covariance
    ours = torch.distributions.MultivariateNormal(torch.zeros(12).double(), model).log_prob(X).mean()
    assert float(ours) == pytest.approx(sklearn.score(X.numpy()), abs=1e-5)


@pytest.mark.parametrize("known", [False, True])
def test_rank_and_parts_are_found(known: bool) -> None:
    X, y, noise, _ = with_factors(80, 2000, factors=4, shared=20, single=6, snr=3.0)
    moments = Moments.from_data(X, y)
    Psi = torch.diag(noise) if known else torch.zeros(26, 26, dtype=torch.float64)
    assert choose_rank(moments, Psi) == 4
    model = fit_factors(moments.xx, 4, Psi)
    assert bool((model.communality[:20] > 0.4).all())
    assert bool((model.communality[20:] < 0.1).all())
    if known:
        assert bool((model.own[20:] > 0.7).all())
        assert bool((model.own[:20] < 0.2 * noise[:20] + 0.01).all())


@pytest.mark.parametrize("known", [False, True])
def test_factor_regression_beats_least_squares_on_shared_inputs(known: bool) -> None:
    ratios = []
    for seed in range(500, 600, 20):
        X, y, noise, b = with_factors(seed, 600, factors=4, shared=40, single=0, snr=2.0)
        L = normal(seed, 4, 40)
        found = FactorRegression(noise if known else None).fit(X, y).coefficients
        least = OrdinaryLeastSquares().fit(X, y).coefficients
        ratios.append(noiseless_error(found, b, L.T @ L) / noiseless_error(least, b, L.T @ L))
    assert float(np.mean(ratios)) < 0.8


def test_noise_of_independent_inputs_cannot_be_found() -> None:
    """Two truths with the same second moments: b through noise of half the variance, and b / 2 without noise."""
    n, b = 200_000, torch.tensor([1.0, -2.0, 0.5], dtype=torch.float64)
    a, e = normal(90, n, 3), normal(91, n, 3)
    noisy = (a + e) / 2**0.5, a @ b * 2**0.5 / 2 + normal(92, n)
    clean = normal(93, n, 3)
    rest = float(noisy[1].var() - (b / 2).square().sum())
    exact = clean, clean @ (b / 2) + rest**0.5 * normal(94, n)
    first, second = Moments.from_data(*noisy), Moments.from_data(*exact)
    assert torch.allclose(first.total / n, second.total / n, atol=0.02)
    for moments in (first, second):
        found = FactorRegression().fit(moments)
        assert found.model.loadings.shape == (3, 0)
        assert torch.allclose(found.coefficients, Stepwise().fit(moments).coefficients, rtol=1e-6)


@pytest.mark.parametrize("method", [EIVARD, FactorRegression])
def test_units_do_not_matter(method) -> None:
    X, y, noise, _ = with_factors(110, 400, factors=2, shared=8, single=2, snr=3.0)
    units = torch.logspace(-4.0, 4.0, 10, dtype=torch.float64)
    b = method(noise).fit(X, y).coefficients
    other = method(noise * units**2).fit(X * units, y).coefficients * units
    assert torch.allclose(other, b, rtol=1e-3, atol=1e-4 * float(b.abs().max()))


@pytest.mark.parametrize("method", [EIVARD, FactorRegression])
@pytest.mark.parametrize("excess", [0.0, 1.0, 100.0])
def test_noise_misstated_or_rank_lacking(method, excess: float) -> None:
    """Noise stated as none, as right, or as more than the inputs hold; a zero column; fewer rows than columns."""
    X, y, noise, _ = with_factors(120, 30, factors=2, shared=40, single=0, snr=3.0)
    X, noise = torch.cat((X, torch.zeros(30, 1)), 1), torch.cat((noise, torch.zeros(1))) * excess
    b = method(noise).fit(X, y).coefficients
    assert bool(b.isfinite().all())
    assert float(b.norm()) < 100.0 * float(OrdinaryLeastSquares().fit(X, y).coefficients.norm())


@pytest.mark.parametrize("method", [EIVARD, FactorRegression])
@pytest.mark.parametrize(
    ("noise", "message"),
    [
        (torch.ones(5), r"expected a variance, variances \(6,\) or a covariance \(6, 6\), got shape \(5,\)"),
        (-torch.ones(6), "at least 0"),
        (torch.full((6,), float("nan")), "expected finite"),
        (torch.triu(torch.ones(6, 6)), "symmetric positive semidefinite"),
    ],
)
def test_bad_noise(method, noise: torch.Tensor, message: str) -> None:
    with pytest.raises(OptionError, match=message):
        method(noise).fit(*problem(0))


def test_a_second_fit_forgets_the_first() -> None:
    first = with_factors(140, 500, factors=4, shared=20, single=0, snr=3.0)
    X, y, _, _ = with_factors(150, 500, factors=1, shared=20, single=0, snr=3.0)
    again = FactorRegression().fit(first[0], first[1]).fit(X, y).coefficients
    assert torch.equal(again, FactorRegression().fit(X, y).coefficients)
