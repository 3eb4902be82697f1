"""The evidence that an estimate gives: against scipy's densities, and never certain where an interval holds zero."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from torchrbd.diagnosis.evidence_cap import bayes_factor


@pytest.mark.parametrize("size", [1, 2, 4])
def test_it_is_the_ratio_of_two_normal_densities(size: int) -> None:
    rng = np.random.default_rng(size)
    A, D, d = rng.standard_normal((size, size + 2)), rng.uniform(0.5, 2.0, size), rng.standard_normal(size)
    C, zero = A @ A.T, np.zeros(size)
    with_effect, without = (multivariate_normal(zero, cov).logpdf(d) for cov in (C + np.diag(D**2), C))
    assert bayes_factor(d, C, D) == pytest.approx(with_effect - without)


@pytest.mark.parametrize("prior_std", [1e-3, 0.1, 1.0, 1e3])
@pytest.mark.parametrize("deviations", [0.0, 1.0, 1.96])
def test_an_interval_that_holds_zero_is_never_certain(deviations: float, prior_std: float) -> None:
    assert bayes_factor(np.array([0.3 * deviations]), np.array([[0.09]]), np.array([prior_std])) < 1.93


def test_it_does_not_depend_on_units() -> None:
    d, C, D = np.array([0.4, -2.0]), np.array([[0.02, 0.1], [0.1, 0.9]]), np.array([1.0, 5.0])
    unit = np.array([1e3, 1e-4])
    assert bayes_factor(d * unit, C * np.outer(unit, unit), D * unit) == pytest.approx(bayes_factor(d, C, D))


def test_certainty_grows_with_the_estimate() -> None:
    C, D = np.diag([0.04, 0.01]), np.ones(2)
    found = [bayes_factor(np.array([x, 0.0]), C, D) for x in (0.2, 0.5, 1.0, 2.0)]
    assert found == sorted(found)
    assert found[0] < 0.0 < found[-1]
