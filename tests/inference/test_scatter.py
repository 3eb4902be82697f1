"""The jackknife over blocks: against fits that are made without each block, and intervals under coloured noise."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
import scipy.stats
import torch
from scipy.signal import lfilter

from torchrbd.dataset.block_statistics import Block, BlockStatistics
from torchrbd.inference.physical.scatter import Scatter, block_scatter

Rows = list[tuple[np.ndarray, np.ndarray]]


def statistics(joints: list[Rows]) -> BlockStatistics:
    """Return the moments of blocks of rows (A, y) of each joint, all of which have all columns."""
    n = joints[0][0][0].shape[1]
    columns = SimpleNamespace(n=n, of_joint=tuple(torch.arange(n) for _ in joints))
    moments = tuple(
        torch.stack([torch.from_numpy(np.c_[A, y].T @ np.c_[A, y]) for A, y in blocks]) for blocks in joints
    )
    torque = torch.tensor([[(len(y), y.sum(), y @ y) for _, y in blocks] for blocks in joints]).movedim(0, 1)
    blocks = tuple(Block("one", float(b), b + 1.0) for b in range(len(joints[0])))
    return BlockStatistics(columns, blocks, moments, torque)  # pyright: ignore[reportArgumentType]


def ridge(joints: list[Rows], variance: np.ndarray, prior: np.ndarray, skip: int | None = None) -> np.ndarray:
    """Return the fit to all blocks but one, with a prior of mean zero and these standard deviations."""
    A, y = [np.diag(1 / prior)], [np.zeros(len(prior))]
    for blocks, v in zip(joints, variance, strict=True):
        for b, (rows, torque) in enumerate(blocks):
            if b != skip:
                A.append(rows / v**0.5)
                y.append(torque / v**0.5)
    return np.linalg.lstsq(np.concatenate(A), np.concatenate(y), rcond=None)[0]


def scatter_of(joints: list[Rows], variance: np.ndarray, prior: np.ndarray) -> tuple[np.ndarray, Scatter]:
    x = ridge(joints, variance, prior)
    H = sum(A.T @ A / v for blocks, v in zip(joints, variance, strict=True) for A, _ in blocks)
    laplace = torch.from_numpy(np.linalg.inv(H + np.diag(prior**-2.0)))
    given = torch.from_numpy(x), torch.arange(len(x)), laplace, torch.from_numpy(variance)
    return x, block_scatter(statistics(joints), *given)


def drawn(seed: int, n_joints: int = 2, n_blocks: int = 6, p: int = 4) -> list[Rows]:
    rng = np.random.default_rng(seed)
    size = 10.0 ** rng.uniform(-3, 3, p)
    return [
        [(rng.standard_normal((9, p)) * size, rng.standard_normal(9)) for _ in range(n_blocks)] for _ in range(n_joints)
    ]


def test_steps_are_those_of_fits_without_each_block() -> None:
    joints, variance, prior = drawn(0), np.array([0.5, 2.0]), np.full(4, 10.0)
    x, scatter = scatter_of(joints, variance, prior)
    without = np.array([x - ridge(joints, variance, prior, skip=b) for b in range(6)])
    size = without.std(0)
    np.testing.assert_allclose(scatter.steps.numpy() / size, (without - without.mean(0)) / size, atol=1e-8)


def test_variance_is_that_of_the_formula() -> None:
    joints, variance, prior = drawn(1), np.array([0.5, 2.0]), np.full(4, 1.0)
    _, scatter = scatter_of(joints, variance, prior)
    g, assumed = np.random.default_rng(2).standard_normal(4), 0.3
    P = np.linalg.inv(scatter.laplace.numpy())
    told = []
    for b in range(6):
        H = sum(blocks[b][0].T @ blocks[b][0] / v for blocks, v in zip(joints, variance, strict=True))
        a = np.linalg.solve(P, g)
        told.append(a @ H @ a)
    nu = sum(told) ** 2 / sum(t**2 for t in told)
    fits = np.array([g @ ridge(joints, variance, prior, skip=b) for b in range(6)])
    believed = g @ np.linalg.solve(P, np.diag(prior**-2.0) @ np.linalg.solve(P, g))
    v = 5 / 6 * np.sum((fits - fits.mean()) ** 2) + believed
    pooled = (2 * assumed + (nu - 1) * v) / (nu + 1)
    expected = pooled * (scipy.stats.t.ppf(0.975, nu + 1) / scipy.stats.norm.ppf(0.975)) ** 2
    assert scatter.variance(torch.from_numpy(g), assumed) == pytest.approx(expected, rel=1e-9)


def test_blocks_alike_count_all_and_one_that_knows_alone_counts_one() -> None:
    A = np.random.default_rng(3).standard_normal((9, 2))
    blocks = [(A * [1.0, b == 3], A @ [1.0, 2.0]) for b in range(8)]
    _, scatter = scatter_of([blocks], np.ones(1), np.full(2, 1e3))
    # The other column is orthogonal to none of the first, so that only its own block tells it.
    assert scatter.effective_blocks(torch.tensor([0.0, 1.0], dtype=torch.float64)) < 1.5
    alike = [(A, A @ [1.0, 2.0]) for _ in range(8)]
    _, scatter = scatter_of([alike], np.ones(1), np.full(2, 1e3))
    assert scatter.effective_blocks(torch.tensor([1.0, 0.0], dtype=torch.float64)) == pytest.approx(8.0)


def test_a_joint_without_torque_says_nothing() -> None:
    joints = drawn(4)
    _, both = scatter_of(joints, np.array([0.5, np.inf]), np.full(4, 10.0))
    _, one = scatter_of(joints[:1], np.array([0.5]), np.full(4, 10.0))
    g = torch.ones(4, dtype=torch.float64)
    assert both.variance(g, 1.0) == pytest.approx(one.variance(g, 1.0), rel=1e-9)


def test_a_column_that_moves_no_joint_spoils_no_other() -> None:
    joints, variance = drawn(6, p=3), np.array([0.5, 2.0])
    x, without = scatter_of(joints, variance, np.full(3, 10.0))
    still = [[(np.c_[A, np.zeros(len(A))], y) for A, y in blocks] for blocks in joints]
    laplace = torch.zeros(4, 4, dtype=torch.float64)
    laplace[:3, :3] = without.laplace
    given = torch.from_numpy(np.append(x, 0.0)), torch.arange(4), laplace, torch.from_numpy(variance)
    scatter, g = block_scatter(statistics(still), *given), torch.tensor([1.0, -2.0, 0.5, 0.0], dtype=torch.float64)
    assert scatter.variance(g, 1.0) == pytest.approx(without.variance(g[:3], 1.0), rel=1e-9)


def coverage(pole: float, seed: int) -> tuple[float, float]:
    """Return how many intervals of 95 % hold the truth, by the scatter and by independent samples.

    Columns that some blocks tell much better than others, noise that forgets itself well within a block.
    """
    rng, p, n_blocks, length, runs = np.random.default_rng(seed), 3, 24, 60, 150
    hits = np.zeros(2)
    for _ in range(runs):
        t = np.arange(n_blocks * length)
        A = np.stack([np.sin(2 * np.pi * t / period + rng.uniform(0, 6)) for period in (37.0, 61.0, 150.0)], axis=1)
        A *= np.repeat(rng.uniform(0.2, 2.0, n_blocks), length)[:, None]
        white = rng.standard_normal(len(t) + 200)
        y = A @ np.ones(p) + (lfilter([1.0], [1.0, -pole], white)[200:] * (1 - pole**2) ** 0.5)
        blocks = [(A[k : k + length], y[k : k + length]) for k in range(0, len(t), length)]
        x, scatter = scatter_of([blocks], np.ones(1), np.full(p, 1e3))
        for k, g in enumerate(torch.eye(p, dtype=torch.float64)):
            assumed = float(scatter.laplace[k, k])
            for which, v in enumerate((max(assumed, scatter.variance(g, assumed)), assumed)):
                hits[which] += abs(x[k] - 1.0) <= 1.96 * v**0.5
    return hits[0] / (runs * p), hits[1] / (runs * p)


@pytest.mark.parametrize("pole", [0.0, 0.8])
def test_intervals_hold_the_truth_under_noise_of_any_colour(pole: float) -> None:
    found, independent = coverage(pole, seed=5)
    # 450 intervals: 0.95 +- 0.02 at two standard errors; wider ones for small samples are no error.
    assert found > 0.925
    if pole:
        assert independent < 0.8
