"""The classical regressions against scikit-learn, numpy and plain loops, on the data that the moments come from."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
import torch
from regression.regressions import normal, problem, rank_deficient
from sklearn.cross_decomposition import PLSRegression
from sklearn.decomposition import PCA
from sklearn.linear_model import Lasso as SklearnLasso
from sklearn.linear_model import LinearRegression
from sklearn.linear_model import Ridge as SklearnRidge
from sklearn.model_selection import KFold, cross_val_score

from torchrbd.errors import OptionError
from torchrbd.regression import (
    Lasso,
    Moments,
    OrdinaryLeastSquares,
    PartialLeastSquares,
    PrincipalComponents,
    Regression,
    Ridge,
    Stepwise,
    TotalLeastSquares,
    TruncatedSVD,
)

ALL = [
    OrdinaryLeastSquares,
    TruncatedSVD,
    TotalLeastSquares,
    Stepwise,
    Ridge,
    Lasso,
    PrincipalComponents,
    PartialLeastSquares,
]
TUNED = [Ridge, Lasso, PrincipalComponents, PartialLeastSquares]


def unit_columns(X: torch.Tensor) -> tuple[np.ndarray, np.ndarray]:
    scale = X.square().mean(0).sqrt()
    return (X / scale).numpy(), scale.numpy()


@pytest.mark.parametrize("seed", [0, 10])
def test_least_squares_is_numpys(seed: int) -> None:
    X, y = problem(seed)
    np.testing.assert_allclose(
        OrdinaryLeastSquares().fit(X, y).coefficients, np.linalg.lstsq(X.numpy(), y.numpy())[0], rtol=1e-8
    )


def test_least_squares_without_rank_is_the_shortest() -> None:
    X, y = rank_deficient(20)
    Z, scale = unit_columns(X)
    shortest = np.linalg.pinv(Z, rcond=1e-6) @ y.numpy() / scale
    np.testing.assert_allclose(OrdinaryLeastSquares().fit(X, y).coefficients, shortest, rtol=1e-6, atol=1e-8)


def test_truncated_svd_is_numpys_pseudo_inverse() -> None:
    X, y = problem(30)
    Z, scale = unit_columns(X)
    s = np.linalg.svd(Z, compute_uv=False)
    tolerance = float(s[3] / s[0]) * 1.01
    expected = np.linalg.pinv(Z, rcond=tolerance) @ y.numpy() / scale
    np.testing.assert_allclose(TruncatedSVD(tolerance).fit(X, y).coefficients, expected, rtol=1e-7)


@pytest.mark.parametrize("given", [False, True])
def test_total_least_squares_is_the_smallest_singular_vector(given: bool) -> None:
    X, y = problem(40)
    rows = torch.cat((X, y.unsqueeze(1)), 1)
    noise = normal(41, 7).square() + 0.1 if given else rows.square().mean(0)
    v = np.linalg.svd((rows / noise.sqrt()).numpy())[2][-1]
    root = noise.sqrt().numpy()
    fitted = TotalLeastSquares(noise if given else None).fit(X, y)
    np.testing.assert_allclose(fitted.coefficients, -v[:-1] / v[-1] * root[-1] / root[:-1], rtol=1e-6)


def test_total_least_squares_finds_b_through_input_noise() -> None:
    clean, b = normal(50, 40_000, 4), normal(51, 4)
    X, y = clean + 0.7 * normal(52, 40_000, 4), clean @ b + 0.7 * normal(53, 40_000)
    found = TotalLeastSquares(torch.full((5,), 0.49)).fit(X, y).coefficients
    assert torch.allclose(found, b, atol=0.04)
    assert not torch.allclose(OrdinaryLeastSquares().fit(X, y).coefficients, b, atol=0.1)


def criterion(X: np.ndarray, y: np.ndarray, chosen: tuple[int, ...]) -> float:
    part = X[:, list(chosen)]
    residual = y - part @ np.linalg.lstsq(part, y)[0] if chosen else y
    return len(y) * math.log(residual @ residual / len(y)) + len(chosen) * math.log(len(y))


@pytest.mark.parametrize("seed", range(60, 120, 10))
def test_stepwise_is_the_naive_loop(seed: int) -> None:
    X, y = problem(seed, n=60, d=7, noise=20.0)
    chosen: tuple[int, ...] = ()
    while True:
        neighbours = [tuple(sorted({*chosen} ^ {k})) for k in range(7)]
        best = min(neighbours, key=lambda c: criterion(X.numpy(), y.numpy(), c))
        if criterion(X.numpy(), y.numpy(), best) >= criterion(X.numpy(), y.numpy(), chosen):
            break
        chosen = best
    b = Stepwise().fit(X, y).coefficients
    assert tuple(torch.nonzero(b).squeeze(1).tolist()) == chosen
    np.testing.assert_allclose(b[list(chosen)], np.linalg.lstsq(X.numpy()[:, list(chosen)], y.numpy())[0], rtol=1e-7)


def test_stepwise_removes_a_column_that_others_replace() -> None:
    A = normal(120, 200, 2)
    mixture = A.sum(1, keepdim=True) + 0.3 * normal(121, 200, 1)
    b = Stepwise().fit(torch.cat((mixture, A), 1), A.sum(1) + 0.01 * normal(122, 200)).coefficients
    assert b[0] == 0.0
    assert torch.allclose(b[1:], torch.ones(2, dtype=torch.float64), atol=0.01)


def test_stepwise_keeps_what_is_always_in() -> None:
    X = normal(130, 100, 4)
    b = Stepwise(always=2).fit(X, X[:, 3]).coefficients
    assert bool((b[:2] != 0.0).all())
    assert b[2] == 0.0


@pytest.mark.parametrize("place", [0, 20, 40])
def test_ridge_is_sklearns(place: int) -> None:
    X, y = problem(140)
    Z, scale = unit_columns(X)
    penalty = float(torch.logspace(3.0, -8.0, 56, dtype=torch.float64)[place])
    expected = SklearnRidge(alpha=len(X) * penalty, fit_intercept=False).fit(Z, y.numpy()).coef_ / scale
    np.testing.assert_allclose(Ridge(at=place).fit(X, y).coefficients, expected, rtol=1e-7)


@pytest.mark.parametrize("place", [10, 50, 90])
def test_lasso_is_sklearns(place: int) -> None:
    X, y = problem(150)
    Z, scale = unit_columns(X)
    largest = np.abs(Z.T @ y.numpy()).max() / len(X)
    model = SklearnLasso(alpha=largest * 10 ** (-3 * place / 99), fit_intercept=False, tol=1e-10, max_iter=100_000)
    expected = model.fit(Z, y.numpy()).coef_
    found = Lasso(at=place).fit(X, y).coefficients.numpy() * scale
    np.testing.assert_allclose(found, expected, atol=5e-3 * np.abs(expected).max())


@pytest.mark.parametrize("components", [1, 3, 6])
def test_components_are_sklearns(components: int) -> None:
    X, y = problem(160)
    X, y = X - X.mean(0), y - y.mean()
    Z, scale = unit_columns(X)
    pls = PLSRegression(components, scale=False).fit(Z, y.numpy())
    at = components - 1
    np.testing.assert_allclose(PartialLeastSquares(at).fit(X, y).coefficients.numpy() * scale, pls.coef_[0], rtol=1e-6)
    pca = PCA(components).fit(Z)
    linear = LinearRegression(fit_intercept=False).fit(pca.transform(Z), y.numpy())
    expected = pca.components_.T @ linear.coef_
    np.testing.assert_allclose(PrincipalComponents(at).fit(X, y).coefficients.numpy() * scale, expected, rtol=1e-6)


def test_cross_validation_is_sklearns_over_blocks() -> None:
    """Columns of unit mean square in every block, so that scaling within folds is no difference."""
    blocks = normal(170, 4, 40, 5) @ normal(171, 5, 5)
    X = (blocks / blocks.square().mean(1, keepdim=True).sqrt()).flatten(0, 1)
    y = X @ normal(172, 5) + 3.0 * normal(173, 160)
    penalties = np.logspace(3.0, -8.0, 56)
    scores = [
        cross_val_score(
            SklearnRidge(alpha=120 * p, fit_intercept=False), X.numpy(), y.numpy(), cv=KFold(4),
            scoring="neg_mean_squared_error",
        ).mean()
        for p in penalties
    ]  # fmt: skip
    model = Ridge().fit(Moments.from_data(X, y, n_blocks=4))
    assert model.chosen == int(np.argmax(scores))
    assert 0 < model.chosen < 55


@pytest.mark.parametrize("method", ALL)
def test_units_do_not_matter(method: type[Regression]) -> None:
    X, y = problem(180)
    units = torch.logspace(-4.0, 4.0, 6, dtype=torch.float64)
    b, other = method().fit(X, y).coefficients, method().fit(X * units, 100.0 * y).coefficients
    assert torch.allclose(other * units / 100.0, b, rtol=1e-4, atol=1e-6 * float(b.abs().max()))


@pytest.mark.parametrize("method", ALL)
@pytest.mark.parametrize("zero_column", [False, True])
def test_inputs_without_rank(method: type[Regression], zero_column: bool) -> None:
    X, y = rank_deficient(190)
    if zero_column:
        X = torch.cat((X, torch.zeros(len(X), 1)), 1)
    fitted = method().fit(X, y)
    assert float((fitted.predict(X) - y).square().mean()) < 0.05 * float(y.square().mean())
    assert float(fitted.coefficients.abs().max()) < 30.0


@pytest.mark.parametrize("method", ALL)
def test_fewer_rows_than_columns(method: type[Regression]) -> None:
    X, b = normal(200, 30, 3) @ normal(201, 3, 40) + 0.1 * normal(202, 30, 40), normal(203, 40)
    fitted = method().fit(X, X @ b)
    assert bool(fitted.coefficients.isfinite().all())
    assert float((fitted.predict(X) - X @ b).square().mean()) < 0.2 * float((X @ b).square().mean())


@pytest.mark.parametrize("method", ALL)
def test_no_output_gives_no_coefficients(method: type[Regression]) -> None:
    X, _ = problem(210)
    assert torch.equal(method().fit(X, torch.zeros(len(X))).coefficients, torch.zeros(6, dtype=torch.float64))


@pytest.mark.parametrize("method", ALL)
def test_data_and_moments_agree(method: type[Regression]) -> None:
    X, y = problem(220)
    fitted = method().fit(X, y)
    assert torch.equal(fitted.coefficients, method().fit(Moments.from_data(X, y)).coefficients)
    assert torch.allclose(fitted.predict(X), X @ fitted.coefficients)


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: TruncatedSVD(0.0), "tolerance: expected a number between 0 and 1, got 0.0"),
        (lambda: Ridge(at=-1), "at: expected a place"),
        (lambda: TotalLeastSquares(torch.ones(3)).fit(*problem(0)), r"expected 7 positive variances.*got shape \(3,\)"),
        (lambda: TotalLeastSquares(torch.zeros(7)).fit(*problem(0)), "positive variances"),
        *[(lambda m=m: m().fit(Moments.from_data(*problem(0), n_blocks=1)), "2 or more blocks") for m in TUNED],
    ],
)
def test_bad_options(build, message: str) -> None:
    with pytest.raises(OptionError, match=message):
        build()


def test_names_differ() -> None:
    assert all(a.name != b.name for a, b in itertools.combinations(ALL, 2))
