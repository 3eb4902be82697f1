"""Columns of one joint as whitening sees them: lasting and brief ones, and rows of another size."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from likelihood.fits import tail_of
from scipy.linalg import toeplitz

from torchrbd.likelihood.brief import Brief
from torchrbd.likelihood.design import Bare, Design
from torchrbd.likelihood.noise import Noise

M, BEFORE = 400, 16


def noise(predictor: list[float], sigma: float = 0.7) -> Noise:
    spread = 1.0 + np.random.default_rng(1).random(M)
    return Noise(np.arange(BEFORE, M), np.array(predictor), sigma, spread)


@pytest.fixture
def design() -> Design:
    rng = np.random.default_rng(0)
    A = rng.standard_normal((9, M))
    for k, begin in ((1, 40), (4, 43), (5, 300)):
        A[k, :begin] = A[k, begin + 12 :] = 0.0
    return Design.of(Bare.of(A, np.arange(9) + 3, rng.standard_normal(M)), [], 0)


@pytest.mark.parametrize("predictor", [[], [0.5], [0.4, -0.3, 0.1]])
def test_rows_are_those_of_the_whole_filter_matrix(design: Design, predictor: list[float]) -> None:
    n = noise(predictor)
    W = toeplitz(np.concatenate(([1.0], -np.array(predictor), np.zeros(M - 1 - len(predictor)))), np.eye(1, M)[0])
    W = W[BEFORE:] / (n.sigma * n.spread[BEFORE:])[:, None]
    b = design.white(n)
    assert len(design.bare.brief) == 3
    np.testing.assert_allclose(b.X, design.A @ W.T, atol=1e-12)
    np.testing.assert_allclose(b.y, W @ design.target, atol=1e-12)
    np.testing.assert_allclose(b.gram, design.A @ W.T @ W @ design.A.T, atol=1e-9)
    np.testing.assert_allclose(b.louder(2.0).gram, 0.25 * b.gram)
    np.testing.assert_allclose(b.louder(2.0).X, 0.5 * b.X)
    np.testing.assert_array_equal(np.sort(b.own), np.arange(9) + 3)


def test_brief_columns_are_what_they_are_as_a_matrix() -> None:
    rng, n = np.random.default_rng(3), noise([0.4, -0.3, 0.1])
    A = rng.standard_normal((5, M)) * (np.abs(np.arange(M) - rng.integers(0, M, (5, 1))) < 6)
    A[1], A[2, 300] = 0.0, 1.0
    n = replace(n, index=np.delete(n.index, [40, 41, 200]))
    for columns in (A, A[:0]):
        white = n.unpredicted(columns)
        brief = Brief.of(columns).unpredicted(n.predictor, n.index)
        np.testing.assert_allclose(brief.dense, white, atol=1e-14)
        C, edges = rng.standard_normal((3, len(n.index))), np.array([5, 60, 61, 300, 370])
        parts = np.stack([white[:, a:b] @ C[:, a:b].T for a, b in pairwise(edges)])
        np.testing.assert_allclose(brief.in_parts(C, edges), parts, atol=1e-12)
        np.testing.assert_allclose(brief.times(C.T), white @ C.T, atol=1e-12)
        np.testing.assert_allclose(brief.products, white @ white.T, atol=1e-12)
        rows = np.array([[3, 3], [299, 0]])
        np.testing.assert_array_equal(brief.of_rows(rows), brief.dense[:, rows])
        kept = np.arange(len(columns)) % 2 == 0
        np.testing.assert_array_equal(brief.some(kept).dense, brief.dense[kept])


def test_what_is_remembered_is_no_other_noise(design: Design) -> None:
    first = noise([0.5])
    heavy = replace(first, tail=tail_of(0.5 + np.random.default_rng(2).random(M)))
    other = noise([-0.2, 0.1], 1.3)
    for n in (first, heavy, other, replace(other, sigma=0.2), first):
        fresh = Design.of(Bare.of(design.A, design.own, design.target), [], 0).white(n)
        kept = design.white(n)
        np.testing.assert_array_equal(kept.X, fresh.X)
        np.testing.assert_array_equal(kept.y, fresh.y)
        np.testing.assert_array_equal(kept.gram, fresh.gram)
