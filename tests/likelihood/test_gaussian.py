"""Check the evidence of linear-Gaussian models against SciPy's multivariate normal density and quadrature."""

import math

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import multivariate_normal, norm

from torchrbd.likelihood.gaussian import Addition, Block, Gaussian, added, mixture

N_COEFFICIENTS = 7


def problem(seed: int, lengths: tuple[int, ...] = (9, 5, 12)) -> list[Block]:
    """Return blocks whose joints share some coefficients and have others alone."""
    rng = np.random.default_rng(seed)
    own = [np.array([0, 1, 2]), np.array([4, 1, 6]), np.array([5, 0, 3, 2])]
    return [
        Block(rng.normal(size=(len(k), m)), 2.0 * rng.normal(size=m), k) for m, k in zip(lengths, own, strict=False)
    ]


def stacked(blocks: list[Block], n: int = N_COEFFICIENTS) -> tuple[np.ndarray, np.ndarray]:
    """Return all rows as one X (M, n) and y (M,)."""
    parts = []
    for b in blocks:
        X = np.zeros((len(b.y), n))
        X[:, b.own] = b.X.T
        parts.append(X)
    return np.concatenate(parts), np.concatenate([b.y for b in blocks])


def log_density(X: np.ndarray, y: np.ndarray) -> float:
    """Return log N(y; 0, X X' + 1)."""
    return float(multivariate_normal.logpdf(y, cov=X @ X.T + np.eye(len(y))))


def extra(seed: int, blocks: list[Block], at: tuple[int, ...], k: int = 2) -> tuple[dict[int, np.ndarray], np.ndarray]:
    """Return columns at some joints, and the same among all rows (M, k)."""
    rng = np.random.default_rng(100 + seed)
    columns = {j: rng.normal(size=(k, len(blocks[j].y))) for j in at}
    rows = [columns[j].T if j in columns else np.zeros((len(b.y), k)) for j, b in enumerate(blocks)]
    return columns, np.concatenate(rows)


@pytest.mark.parametrize("seed", range(4))
def test_log_evidence_is_the_marginal_density(seed: int) -> None:
    blocks = problem(seed)
    X, y = stacked(blocks)
    expected = log_density(X, y) + 0.5 * len(y) * math.log(2 * math.pi)
    assert Gaussian(blocks, N_COEFFICIENTS).log_evidence == pytest.approx(expected, rel=1e-12)


def test_posterior_is_that_of_the_stacked_rows() -> None:
    blocks = problem(0)
    X, y = stacked(blocks)
    got = Gaussian(blocks, N_COEFFICIENTS)
    C = np.linalg.inv(X.T @ X + np.eye(N_COEFFICIENTS))
    np.testing.assert_allclose(got.z, C @ X.T @ y, rtol=1e-10)
    np.testing.assert_allclose(got.covariance([4, 0]), C[np.ix_([4, 0], [4, 0])], rtol=1e-10)
    np.testing.assert_allclose(np.concatenate(got.left), y - X @ got.z, rtol=1e-9, atol=1e-12)


def test_degrees_of_freedom_are_the_trace_of_the_hat_matrix() -> None:
    blocks = problem(1)
    X, _ = stacked(blocks)
    hat = X @ np.linalg.solve(X.T @ X + np.eye(N_COEFFICIENTS), X.T)
    ends = np.cumsum([0, *(len(b.y) for b in blocks)])
    got = Gaussian(blocks, N_COEFFICIENTS)
    for j in range(3):
        assert got.used(j) == pytest.approx(hat.diagonal()[ends[j] : ends[j + 1]].sum(), rel=1e-10)


@pytest.mark.parametrize("at", [(1,), (0, 2), (0, 1, 2)])
def test_added_columns_raise_the_density_by_their_evidence(at: tuple[int, ...]) -> None:
    blocks = problem(2)
    X, y = stacked(blocks)
    columns, rows = extra(2, blocks, at)
    std = np.array([0.3, 2.0])
    got = Gaussian(blocks, N_COEFFICIENTS)
    S, r = got.beside(columns)
    one = added(S, r, std)
    whole = np.concatenate((X, rows * std), 1)
    assert one.log_evidence == pytest.approx(log_density(whole, y) - log_density(X, y), rel=1e-9)
    C = np.linalg.inv(whole.T @ whole + np.eye(whole.shape[1]))
    np.testing.assert_allclose(one.mean, std * (C @ whole.T @ y)[-2:], rtol=1e-9)
    np.testing.assert_allclose(one.std, std * np.sqrt(C.diagonal()[-2:]), rtol=1e-9)


def test_precision_and_score_are_those_of_the_rows_that_the_model_leaves() -> None:
    blocks = problem(3)
    X, y = stacked(blocks)
    columns, rows = extra(3, blocks, (0, 1))
    V = np.linalg.inv(np.eye(len(y)) + X @ X.T)
    S, r = Gaussian(blocks, N_COEFFICIENTS).beside(columns)
    np.testing.assert_allclose(S, rows.T @ V @ rows, rtol=1e-9)
    np.testing.assert_allclose(r, rows.T @ V @ y, rtol=1e-9)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("std", [0.05, 0.5, 3.0])
def test_coefficient_that_is_not_negative_is_integrated_over_the_half_line(sign: float, std: float) -> None:
    blocks = problem(4)
    X, y = stacked(blocks)
    columns, rows = extra(4, blocks, (1,), 1)
    S, r = Gaussian(blocks, N_COEFFICIENTS).beside({1: sign * columns[1]})
    c, cov = sign * rows[:, 0], X @ X.T + np.eye(len(y))
    base = log_density(X, y)

    def integrand(w: float) -> float:
        density = multivariate_normal.logpdf(y - c * w, cov=cov) - base
        return math.exp(density) * 2.0 * norm.pdf(w, scale=std)

    expected = math.log(quad(integrand, 0.0, 12.0 * std, epsabs=1e-13)[0])
    assert added(S, r, np.array([std]), positive=(0,)).log_evidence == pytest.approx(expected, abs=1e-7)


def test_column_that_is_known_to_be_nothing_changes_nothing() -> None:
    one = added(np.diag([3.0, 2.0]), np.array([1.0, -2.0]), np.array([0.0, 0.5]), positive=(0,))
    alone = added(np.array([[2.0]]), np.array([-2.0]), np.array([0.5]))
    assert one.log_evidence == pytest.approx(alone.log_evidence)
    assert (one.mean[0], one.std[0]) == (0.0, 0.0)


def test_evidence_does_not_depend_on_the_units_of_a_coefficient() -> None:
    blocks = problem(5)
    columns, _ = extra(5, blocks, (0, 2))
    got, unit, std = Gaussian(blocks, N_COEFFICIENTS), np.array([1e4, 1e-3]), np.array([0.3, 2.0])
    one = added(*got.beside(columns), std, positive=(1,))
    other = added(*got.beside({j: C / unit[:, None] for j, C in columns.items()}), std * unit, positive=(1,))
    assert other.log_evidence == pytest.approx(one.log_evidence, rel=1e-9)
    np.testing.assert_allclose(other.mean, one.mean * unit, rtol=1e-9)


def test_among_is_the_model_that_was_built_without() -> None:
    blocks, kept = problem(6), np.array([0, 2, 3, 5])
    got = Gaussian(blocks, N_COEFFICIENTS).among(kept)
    number = {int(k): i for i, k in enumerate(kept)}
    inside = [np.isin(b.own, kept) for b in blocks]
    alone = Gaussian(
        [
            Block(b.X[k], b.y, np.array([number[int(o)] for o in b.own[k]], dtype=int))
            for b, k in zip(blocks, inside, strict=True)
        ],
        len(kept),
    )
    assert got.log_evidence == pytest.approx(alone.log_evidence, rel=1e-12)
    np.testing.assert_allclose(got.z, alone.z, rtol=1e-10)
    columns, _ = extra(6, blocks, (0, 1))
    for one, other in zip(got.beside(columns), alone.beside(columns), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-12)
    for j in range(3):
        assert got.used(j) == pytest.approx(alone.used(j))
        np.testing.assert_allclose(got.left[j], alone.left[j], atol=1e-12)


@pytest.mark.parametrize("index", [[3], [1, 6], [0, 2, 5]])
def test_against_zero_is_the_evidence_of_having_the_coefficients(index: list[int]) -> None:
    blocks = problem(7)
    X, y = stacked(blocks)
    kept = np.setdiff1d(np.arange(N_COEFFICIENTS), index)
    expected = log_density(X, y) - log_density(X[:, kept], y)
    assert Gaussian(blocks, N_COEFFICIENTS).against_zero(index) == pytest.approx(expected, rel=1e-9)


def test_joint_without_rows_says_nothing() -> None:
    blocks = problem(8)
    empty = Block(np.zeros((2, 0)), np.zeros(0), np.array([3, 4]))
    got, other = Gaussian([*blocks, empty], N_COEFFICIENTS), Gaussian(blocks, N_COEFFICIENTS)
    assert got.log_evidence == pytest.approx(other.log_evidence)
    assert got.used(3) == 0.0


def test_mixture_averages_the_evidence_and_has_the_best_ones_coefficients() -> None:
    parts = [Addition(e, np.array([e]), np.array([1.0 + e])) for e in (-3.0, 2.0, 1.0)]
    got = mixture(parts)
    assert got.log_evidence == pytest.approx(math.log(np.exp([-3.0, 2.0, 1.0]).mean()))
    assert (got.mean[0], got.std[0]) == (2.0, 3.0)
    assert mixture([Addition(900.0, np.zeros(1), np.zeros(1))] * 3).log_evidence == pytest.approx(900.0)


def test_matrix_that_is_no_precision_is_refused() -> None:
    with pytest.raises(np.linalg.LinAlgError):
        added(np.array([[1.0, 5.0], [5.0, 1.0]]), np.zeros(2), np.ones(2))
