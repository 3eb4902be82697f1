"""Check the evidence of linear-Gaussian models against SciPy's multivariate normal density and quadrature."""

import math

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import multivariate_normal, norm

from torchrbd.likelihood.gaussian import Block, Gaussian, Posterior, Quadratic, added, nonnegative

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
    np.testing.assert_allclose(np.concatenate([got.left(j) for j in range(3)]), y - X @ got.z, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("units", [1.0, 1e6])
def test_posterior_of_normal_equations_is_that_of_the_rows(units: float) -> None:
    """Whatever the units of a coefficient; additional columns are projected."""
    rng = np.random.default_rng(13)
    X, y, C = rng.normal(size=(20, 4)), rng.normal(size=20), rng.normal(size=(20, 2))
    X[:, 1] *= units
    prior = np.diag([1.0, units**2, 1.0, 1.0])
    left = X[:15]
    H = left.T @ left + prior
    got = Posterior(H, left.T @ y[:15])
    np.testing.assert_allclose(got.z, np.linalg.solve(H, left.T @ y[:15]), rtol=1e-9)
    np.testing.assert_allclose(got.root.matrix @ got.root.matrix.T, H, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(got.root.matrix @ got.half(H), H, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(got.solve(H), np.eye(4), atol=1e-6)
    S = C[:15].T @ C[:15] - C[:15].T @ left @ np.linalg.solve(H, left.T @ C[:15])
    np.testing.assert_allclose(got.schur(left.T @ C[:15], C[:15].T @ C[:15]), S, rtol=1e-9)


def test_coefficient_that_nothing_tells_is_zero_where_rounding_is_all_of_the_prior() -> None:
    rng = np.random.default_rng(14)
    X, y = rng.normal(size=(20, 3)), rng.normal(size=20)
    X[:, 1] = 0.0
    expected = np.linalg.lstsq(X, y, rcond=None)[0]
    np.testing.assert_allclose(Posterior(X.T @ X, X.T @ y, 1e-11).z, expected, atol=1e-9)


def test_matrix_that_is_no_posterior_precision_is_refused() -> None:
    with pytest.raises(np.linalg.LinAlgError):
        Posterior(np.array([[1.0, 5.0], [5.0, 1.0]]), np.zeros(2))


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
    S, r = got.precision_and_score(columns)
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
    S, r = Gaussian(blocks, N_COEFFICIENTS).precision_and_score(columns)
    np.testing.assert_allclose(S, rows.T @ V @ rows, rtol=1e-9)
    np.testing.assert_allclose(r, rows.T @ V @ y, rtol=1e-9)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("std", [0.05, 0.5, 3.0])
def test_coefficient_that_is_not_negative_is_integrated_over_the_half_line(sign: float, std: float) -> None:
    blocks = problem(4)
    X, y = stacked(blocks)
    columns, rows = extra(4, blocks, (1,), 1)
    S, r = Gaussian(blocks, N_COEFFICIENTS).precision_and_score({1: sign * columns[1]})
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
    one = added(*got.precision_and_score(columns), std, positive=(1,))
    other = added(
        *got.precision_and_score({j: C / unit[:, None] for j, C in columns.items()}), std * unit, positive=(1,)
    )
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
    for one, other in zip(got.precision_and_score(columns), alone.precision_and_score(columns), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-12)
    for j in range(3):
        assert got.used(j) == pytest.approx(alone.used(j))
        np.testing.assert_allclose(got.left(j), alone.left(j), atol=1e-12)


@pytest.mark.parametrize("grouped", [False, True])
def test_without_is_the_posterior_of_the_other_rows(grouped: bool) -> None:
    blocks, local = problem(15), [np.zeros(0, int), np.array([4, 6]), np.array([5, 3])] if grouped else []
    blocks[1] = blocks[1].sized(np.array([0.5, 2.0, 1.5])).louder(3.0)
    sites = np.zeros((3, N_COEFFICIENTS))
    sites[:2, 4] = 2.5, -1.2
    first = Quadratic(2.0 * np.eye(3), np.array([0.3, -0.1, 0.2]), -0.7)
    rows = [np.array([0, 4, 5]), np.zeros(0, int), np.array([11])]
    got = Gaussian(blocks, N_COEFFICIENTS, first, sites, local).without(rows)
    kept = [np.setdiff1d(np.arange(len(b.y)), r) for b, r in zip(blocks, rows, strict=True)]
    others = [Block(b.X[:, k], b.y[k], b.own) for b, k in zip(blocks, kept, strict=True)]
    expected = Gaussian(others, N_COEFFICIENTS, first, sites)
    np.testing.assert_allclose(got.z, expected.z, rtol=1e-10)
    assert got.log_evidence == pytest.approx(expected.log_evidence, rel=1e-12)
    np.testing.assert_allclose(got.H, expected.H, rtol=1e-10, atol=1e-12)
    for j in range(3):
        np.testing.assert_allclose(got.left(j), expected.left(j), atol=1e-11)


@pytest.mark.parametrize("index", [[3], [1, 6], [0, 2, 5]])
@pytest.mark.parametrize("value", [0.0, 0.7, -1.3])
def test_against_a_value_is_the_evidence_of_not_knowing_the_coefficients(index: list[int], value: float) -> None:
    """A model whose coefficients are known has the density of what their torque leaves."""
    blocks = problem(7)
    X, y = stacked(blocks)
    kept, known = np.setdiff1d(np.arange(N_COEFFICIENTS), index), value + 0.1 * np.arange(len(index)) * (value != 0.0)
    expected = log_density(X, y) - log_density(X[:, kept], y - X[:, index] @ known)
    got = Gaussian(blocks, N_COEFFICIENTS)
    assert got.against(index, known) == pytest.approx(expected, rel=1e-9)
    if value == 0.0:
        assert got.against(index) == got.against(index, known)


@pytest.mark.parametrize("value", [np.zeros(2), np.array([0.4, -1.1]), 0.8])
def test_against_a_value_is_the_ratio_of_prior_and_posterior_density_there(value: np.ndarray | float) -> None:
    got, index = Gaussian(problem(7), N_COEFFICIENTS), [1, 6]
    at = np.broadcast_to(value, 2)
    before, after = multivariate_normal(np.zeros(2)), multivariate_normal(got.z[index], got.covariance(index))
    # What the data leave likelier than before there is none against it.
    assert got.against(index, value) == pytest.approx(before.logpdf(at) - after.logpdf(at), rel=1e-9)
    assert Gaussian(problem(7), N_COEFFICIENTS).against(index, got.z[index]) < got.against(index, value)


def test_joint_without_rows_says_nothing() -> None:
    blocks = problem(8)
    empty = Block(np.zeros((2, 0)), np.zeros(0), np.array([3, 4]))
    got, other = Gaussian([*blocks, empty], N_COEFFICIENTS), Gaussian(blocks, N_COEFFICIENTS)
    assert got.log_evidence == pytest.approx(other.log_evidence)
    assert got.used(3) == 0.0


def test_batches_are_their_problems_one_by_one() -> None:
    rng = np.random.default_rng(9)
    R = rng.normal(size=(4, 3, 3))
    S, r, std = R @ R.transpose(0, 2, 1), rng.normal(size=(4, 3)), rng.uniform(0.0, 2.0, (4, 5, 3))
    std[1, 2, 0] = 0.0
    whole = added(S[:, None], r[:, None], std, positive=(0,))
    assert whole.log_evidence.shape == (4, 5)
    assert whole.mean.shape == whole.std.shape == (4, 5, 3)
    for i, k in np.ndindex(4, 5):
        one = added(S[i], r[i], std[i, k], positive=(0,))
        assert whole.log_evidence[i, k] == pytest.approx(one.log_evidence, rel=1e-9, abs=1e-12)
        np.testing.assert_allclose(whole.mean[i, k], one.mean, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(whole.std[i, k], one.std, rtol=1e-9)


def test_first_coefficients_may_have_any_log_density() -> None:
    """Their normalised Gaussian prior N(m, C), and N(0, 1) of the others, make the marginal density of the rows."""
    blocks = problem(10)
    X, y = stacked(blocks)
    rng = np.random.default_rng(10)
    R, m = rng.normal(size=(3, 3)), rng.normal(size=3)
    C = R @ R.T + np.eye(3)
    P = np.linalg.inv(C)
    # Densities are over that of N(0, 1) without its 2 pi.
    constant = -0.5 * float(m @ P @ m) + 0.5 * float(np.linalg.slogdet(P)[1])
    got = Gaussian(blocks, N_COEFFICIENTS, Quadratic(P, P @ m, constant))
    whole, mean = np.eye(N_COEFFICIENTS), np.zeros(N_COEFFICIENTS)
    whole[:3, :3], mean[:3] = C, m
    covariance = X @ whole @ X.T + np.eye(len(y))
    expected = multivariate_normal.logpdf(y, X @ mean, covariance) + 0.5 * len(y) * math.log(2 * math.pi)
    assert got.log_evidence == pytest.approx(expected, rel=1e-12)
    np.testing.assert_allclose(got.z, mean + whole @ X.T @ np.linalg.solve(covariance, y - X @ mean), rtol=1e-9)


def test_sites_multiply_the_prior() -> None:
    """A site is a further row of the data: precision p and shift s are what y = s / root p says of root p z."""
    blocks = problem(11)
    sites = np.zeros((3, N_COEFFICIENTS))
    sites[:2, 4] = 2.5, -1.2
    got = Gaussian(blocks, N_COEFFICIENTS, sites=sites)
    row = Block(np.array([[math.sqrt(2.5)]]), np.array([-1.2 / math.sqrt(2.5)]), np.array([4]))
    other = Gaussian([*blocks, row], N_COEFFICIENTS)
    np.testing.assert_allclose(got.z, other.z, rtol=1e-10)
    np.testing.assert_allclose(got.covariance([4, 1]), other.covariance([4, 1]), rtol=1e-10)
    np.testing.assert_allclose(got.H - np.diag(sites[0]), Gaussian(blocks, N_COEFFICIENTS).H)


def test_what_joints_have_alone_may_be_eliminated_first() -> None:
    """Coefficients 4 and 6 are of the second block alone, 3 and 5 of the third: nothing else changes."""
    blocks, local = problem(13), [np.zeros(0, int), np.array([4, 6]), np.array([5, 3])]
    sites = np.zeros((3, N_COEFFICIENTS))
    sites[:2, 4] = 2.5, -1.2
    got, dense = (Gaussian(blocks, N_COEFFICIENTS, sites=sites, local=some) for some in (local, []))
    np.testing.assert_allclose(got.root.matrix @ got.root.matrix.T, got.H, rtol=1e-10, atol=1e-10)
    np.testing.assert_allclose(got.z, dense.z, rtol=1e-10)
    every = np.arange(N_COEFFICIENTS)
    np.testing.assert_allclose(got.covariance(every), dense.covariance(every), rtol=1e-9, atol=1e-12)
    assert got.log_evidence == pytest.approx(dense.log_evidence, rel=1e-12)
    assert [got.used(j) for j in range(3)] == pytest.approx([dense.used(j) for j in range(3)], rel=1e-10)
    columns, _ = extra(13, blocks, (0, 2))
    for one, other in zip(got.precision_and_score(columns), dense.precision_and_score(columns), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9)
    kept = np.array([0, 1, 3, 4])
    np.testing.assert_allclose(got.among(kept).z, dense.among(kept).z, rtol=1e-10)
    precision, shift = got.first(2)
    cov = dense.covariance([0, 1])
    np.testing.assert_allclose(precision, np.linalg.inv(cov), rtol=1e-9)
    np.testing.assert_allclose(shift, np.linalg.solve(cov, dense.z[:2]), rtol=1e-9)


@pytest.mark.parametrize("centre", [(0.5, -0.3, 0.2), (-0.8, 0.4, 0.6), (2.0, 1.5, -0.5)])
def test_sites_have_the_moments_of_the_truncated_density(centre: tuple[float, ...]) -> None:
    rng = np.random.default_rng(12)
    C, m = np.array([[1.0, 0.4, -0.2], [0.4, 0.8, 0.1], [-0.2, 0.1, 0.5]]), np.array(centre)
    draws = rng.multivariate_normal(m, C, 1_500_000)
    kept = draws[(draws >= 0).all(1)]
    assert len(kept) > 50_000
    precision, shift, _ = nonnegative(m, C)
    assert (precision >= 0).all()
    covariance = np.linalg.inv(np.linalg.inv(C) + np.diag(precision))
    mean = covariance @ (np.linalg.solve(C, m) + shift)
    np.testing.assert_allclose(mean, kept.mean(0), rtol=0.02)
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)), kept.std(0), rtol=0.02)


@pytest.mark.parametrize("seed", [3, 11, 14])
def test_evidence_of_a_truncated_prior_counts_what_the_posterior_has_of_it(seed: int) -> None:
    """p(y | z >= 0) = p(y) p(z >= 0 | y) / p(z >= 0)."""
    blocks, at = problem(seed), [1, 4, 5]
    free = Gaussian(blocks, N_COEFFICIENTS)
    sites = np.zeros((3, N_COEFFICIENTS))
    sites[:, at] = nonnegative(free.z[at], free.covariance(at))
    after = multivariate_normal.cdf(np.zeros(3), -free.z[at], free.covariance(at), rng=np.random.default_rng(0))
    expected = free.log_evidence + math.log(after) + 3 * math.log(2)
    assert Gaussian(blocks, N_COEFFICIENTS, sites=sites).log_evidence == pytest.approx(expected, abs=0.05)


def test_coefficient_that_is_surely_positive_needs_no_site() -> None:
    precision, shift, constant = nonnegative(np.array([9.0, 0.0]), np.diag([1.0, 1.0]))
    assert (abs(precision[0]), abs(shift[0])) == pytest.approx((0.0, 0.0), abs=1e-9)
    # A half-normal density has mean root(2 / pi) and variance 1 - 2 / pi.
    variance = 1.0 / (1.0 + precision[1])
    assert variance == pytest.approx(1.0 - 2.0 / math.pi)
    assert variance * shift[1] == pytest.approx(math.sqrt(2.0 / math.pi))
    # The first has twice the density of the normal prior, the second as much as a whole one.
    assert constant == pytest.approx([math.log(2.0), -0.5 * (math.log(variance) + variance * shift[1] ** 2)])


def test_matrix_that_is_no_precision_is_refused() -> None:
    with pytest.raises(np.linalg.LinAlgError):
        added(np.array([[1.0, 5.0], [5.0, 1.0]]), np.zeros(2), np.ones(2))


def test_one_coefficient_is_as_one_of_two_whose_other_cannot_be() -> None:
    rng = np.random.default_rng(10)
    S, r, std = rng.uniform(0.0, 5.0, (6, 1, 1)), rng.normal(size=(6, 1)), rng.uniform(0.0, 2.0, (6, 1))
    both = np.tile(np.eye(2), (6, 1, 1)) * S, np.pad(r, ((0, 0), (0, 1)), constant_values=3.0)
    one, two = added(S, r, std, positive=(0,)), added(*both, np.pad(std, ((0, 0), (0, 1))), positive=(0,))
    np.testing.assert_allclose(one.log_evidence, two.log_evidence, rtol=1e-12, atol=1e-13)
    np.testing.assert_allclose(one.mean[:, 0], two.mean[:, 0], rtol=1e-12)
    np.testing.assert_allclose(one.std[:, 0], two.std[:, 0], rtol=1e-12)
    with pytest.raises(np.linalg.LinAlgError, match="no positive definite precision"):
        added(np.array([[-5.0]]), np.zeros(1), np.ones(1))
