"""Whitening of joints whose samples may count little, against simulated noise."""

from __future__ import annotations

import numpy as np
import pytest
from diagnosis.locate.field import background, case
from scipy.signal import lfilter

from torchrbd.diagnosis.rows.white_rows import ORDER, joint_noise, predictor

A = np.array([0.9, -0.4, 0.1, 0.05])


def test_predictor_is_that_of_the_noise() -> None:
    noise = lfilter([1.0], [1.0, *-A], np.random.default_rng(2).standard_normal(400_000))
    np.testing.assert_allclose(predictor(noise, np.arange(ORDER, len(noise))), A, atol=0.06)


def test_rows_beside_sticks_have_unit_variance() -> None:
    """Samples hold something unknown of the variance that their weights tell, at random places."""
    rng = np.random.default_rng(3)
    noise = lfilter([1.0], [1.0, *-A], rng.standard_normal(200_000))
    weight = np.where(rng.random(len(noise)) < 0.3, rng.uniform(0.05, 0.9, len(noise)), 1.0)
    index = np.arange(ORDER, len(noise))
    got, alike = joint_noise(index, A, 2.0, weight), joint_noise(index, A, 2.0, np.ones(len(noise)))
    seen = noise + np.sqrt(got.correlation[0] * (1 / weight**2 - 1)) * rng.standard_normal(len(noise))
    plain, counts = alike.white(2.0 * seen * weight), got.white(2.0 * seen * weight)
    for part in (weight[index] == 1, weight[index - 1] < 0.3, weight[index] < 0.3):
        assert np.mean(plain[part] ** 2) > 1.1
        assert np.mean(counts[part] ** 2) == pytest.approx(1.0, abs=0.03)
    np.testing.assert_allclose(alike.spread, 1.0)


def test_rows_of_a_null_have_unit_variance_where_they_count() -> None:
    fit = background(case(61))
    rows = fit.rows
    for j, part in enumerate(rows.parts):
        full = rows.samples.weight[j][rows.index[j]] > 0.95
        assert np.mean(fit.e[part][full] ** 2) == pytest.approx(1.0, abs=0.25)
        assert 0 < rows.counts[j] <= len(full)
