"""Whitening against filters, spectra and simulated noise."""

from __future__ import annotations

import numpy as np
import pytest
from diagnosis.locate.field import background, case
from scipy.signal import lfilter

from torchrbd.diagnosis.rows.whitening import ORDER, autocovariance, predictor, relief, whitened

A = np.array([0.9, -0.4, 0.1, 0.05])


def coloured(samples: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    white = np.random.default_rng(seed).standard_normal(samples)
    return white, lfilter([1.0], [1.0, *-A], white)


def test_whitened_coloured_noise_is_white() -> None:
    white, noise = coloured(4000, 1)
    index = np.arange(ORDER, 4000)
    both = whitened(np.stack((noise, 3 * noise)), index, A, 2.0)
    np.testing.assert_allclose(both, [white[ORDER:] / 2, 1.5 * white[ORDER:]], atol=1e-12)
    np.testing.assert_allclose(whitened(noise, index[5:9], A, 2.0), white[ORDER:][5:9] / 2, atol=1e-12)


def test_predictor_and_autocovariance_are_those_of_the_noise() -> None:
    _, noise = coloured(400_000, 2)
    np.testing.assert_allclose(predictor(noise, np.arange(ORDER, len(noise))), A, atol=0.06)
    lags = [np.mean(noise[k:] * noise[: len(noise) - k]) for k in range(ORDER + 1)]
    np.testing.assert_allclose(autocovariance(A, 1.0), lags, atol=0.03)
    np.testing.assert_allclose(autocovariance(A, 3.0), 9 * autocovariance(A, 1.0))


def test_rows_beside_sticks_have_unit_variance() -> None:
    """Samples hold something unknown of the variance that their weights tell, at random places."""
    rng = np.random.default_rng(3)
    _, noise = coloured(200_000, 3)
    weight = np.where(rng.random(len(noise)) < 0.3, rng.uniform(0.05, 0.9, len(noise)), 1.0)
    c = autocovariance(A, 1.0)[0]
    seen = noise + np.sqrt(c * (1 / weight**2 - 1)) * rng.standard_normal(len(noise))
    index = np.arange(ORDER, len(noise))
    plain, counts = whitened(seen * weight, index, A, 1.0), relief(weight, index, A)
    for part in (weight[index] == 1, weight[index - 1] < 0.3, weight[index] < 0.3):
        assert np.mean(plain[part] ** 2) > 1.1
        assert np.mean((plain * counts)[part] ** 2) == pytest.approx(1.0, abs=0.03)
    assert np.all(relief(np.ones(50), np.arange(ORDER, 50), A) == pytest.approx(1.0))


def test_rows_of_a_null_have_unit_variance_where_they_count() -> None:
    fit = background(case(61))
    rows = fit.rows
    for j, part in enumerate(rows.parts):
        full = rows.samples.weight[j][rows.index[j]] > 0.95
        assert np.mean(fit.e[part][full] ** 2) == pytest.approx(1.0, abs=0.25)
        assert 0 < rows.counts[j] <= len(full)
