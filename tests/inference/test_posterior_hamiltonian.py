"""Split Hamiltonian trajectories: moments by quadrature, a truncated Gaussian, and autocorrelation times."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.integrate
import scipy.stats
import torch
from torch import Tensor

from torchrbd.inference.posterior.hamiltonian import Rest, autocorrelation_time, sample


def tilted(e: Tensor) -> tuple[Tensor, Tensor]:
    """log R = sum (e - e^4 / 2), each coordinate for itself."""
    return (e - 0.5 * e**4).sum(1), 1.0 - 2.0 * e**3


def edged(e: Tensor) -> tuple[Tensor, Tensor]:
    """R = prod (2 + e)^3, 0 where a coordinate is below -2."""
    inside = (e > -2.0).all(1)
    return torch.where(inside, 3.0 * (2.0 + e).clamp_min(1e-9).log().sum(1), -torch.inf), 3.0 / (2.0 + e)


def cut(e: Tensor) -> tuple[Tensor, Tensor]:
    """R = 1 where the first coordinate is above -0.5, else 0: no slope tells of the edge."""
    return torch.where(e[:, 0] > -0.5, 0.0, -torch.inf).double(), torch.zeros_like(e)


def plain(e: Tensor) -> tuple[Tensor, Tensor]:
    return e.new_zeros(len(e)), torch.zeros_like(e)


@pytest.mark.parametrize(("rest", "low"), [(tilted, -np.inf), (edged, -2.0), (plain, -np.inf)])
def test_every_coordinate_has_the_distribution_of_quadrature(rest: Rest, low: float) -> None:
    def density(x: float) -> float:
        value = float(rest(torch.tensor([[x]], dtype=torch.float64))[0])
        return float(np.exp(value - 0.5 * x * x))

    moments = [scipy.integrate.quad(lambda x, k=k: x**k * density(x), low, np.inf)[0] for k in range(3)]
    mean = moments[1] / moments[0]
    std = (moments[2] / moments[0] - mean**2) ** 0.5
    e = sample(rest, 5, 6000, seed=3).e.numpy()
    # Samples are thinned by twice their autocorrelation time: 4 standard errors of independent ones.
    assert np.abs(e.mean(0) - mean).max() < 4 * std / 6000**0.5
    assert np.abs(e.std(0) / std - 1.0).max() < 0.04
    if rest is plain:
        assert scipy.stats.kstest(e[:, 0], scipy.stats.norm.cdf).pvalue > 1e-3
    assert e.min() > low


def test_an_edge_without_slope() -> None:
    e = sample(cut, 2, 2000, seed=5).e.numpy()
    assert scipy.stats.kstest(e[:, 0], scipy.stats.truncnorm(-0.5, np.inf).cdf).pvalue > 1e-3
    assert scipy.stats.kstest(e[:, 1], scipy.stats.norm.cdf).pvalue > 1e-3


def test_number_and_seed() -> None:
    few, same, other = (sample(tilted, 2, 5, seed=seed).e for seed in (0, 0, 1))
    assert few.shape == (5, 2)
    assert torch.equal(few, same)
    assert not torch.equal(few, other)


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.9])
def test_autocorrelation_time_of_an_autoregression(rho: float) -> None:
    rng = np.random.default_rng(0)
    series = np.zeros((2000, 30, 2))
    for t in range(1, 2000):
        series[t] = np.array([rho, 0.0]) * series[t - 1] + rng.normal(size=(30, 2))
    found = autocorrelation_time(torch.from_numpy(series[200:]))
    assert found == pytest.approx((1 + rho) / (1 - rho), rel=0.15)
