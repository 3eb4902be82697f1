"""Moments are those of numpy, add up over blocks and follow linear maps of the inputs."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from regression.regressions import normal, problem

from torchrbd.errors import InputError
from torchrbd.regression import Moments


def test_moments_are_numpys() -> None:
    X, y = problem(0, n=53)
    moments = Moments.from_data(X, y, n_blocks=7)
    assert moments.blocks.shape == (7, 7, 7)
    assert (moments.n, moments.d) == (53.0, 6)
    np.testing.assert_allclose(moments.xx, X.numpy().T @ X.numpy() / 53, rtol=1e-12)
    np.testing.assert_allclose(moments.xy, X.numpy().T @ y.numpy() / 53, rtol=1e-12)
    np.testing.assert_allclose(moments.yy, np.mean(y.numpy() ** 2), rtol=1e-12)


def test_blocks_left_out_are_rows_left_out() -> None:
    X, y = problem(4, n=60)
    keep = torch.arange(6) != 2
    rows = torch.arange(60) // 10 != 2
    left = Moments.from_data(X, y, n_blocks=6).select(keep)
    assert torch.allclose(left.total, Moments.from_data(X[rows], y[rows]).total, rtol=1e-12)
    assert left.n == 50.0


def test_transform_is_that_of_the_rows() -> None:
    X, y = problem(8)
    W = normal(9, 3, 6)
    mapped, direct = Moments.from_data(X, y).transform(W), Moments.from_data(X @ W.T, y)
    assert torch.allclose(mapped.blocks, direct.blocks, rtol=1e-10)


def test_error_is_that_of_the_rows() -> None:
    X, y = problem(12)
    moments, B = Moments.from_data(X, y), normal(13, 6, 4)
    expected = (y.unsqueeze(1) - X @ B).square().mean(0) - y.square().mean()
    assert torch.allclose(moments.error(B), expected, rtol=1e-9)
    assert torch.allclose(torch.stack([moments.error(b) for b in B.T]), expected, rtol=1e-9)


def test_fewer_rows_than_blocks() -> None:
    assert len(Moments.from_data(*problem(0, n=3)).count) == 3


@pytest.mark.parametrize(
    ("X", "y", "message"),
    [
        (torch.ones(4, 2), torch.ones(3), r"got \(4, 2\) and \(3,\)"),
        (torch.ones(4), torch.ones(4), r"expected X \(N, d\)"),
        (torch.ones(0, 2), torch.ones(0), "N at least 1"),
        (torch.tensor([[1.0], [float("nan")]]), torch.ones(2), "row 1 has nan"),
    ],
)
def test_bad_rows(X: torch.Tensor, y: torch.Tensor, message: str) -> None:
    with pytest.raises(InputError, match=message):
        Moments.from_data(X, y)
