"""Components added to a machine: the small model says what the one with all rows says."""

from __future__ import annotations

import numpy as np
import pytest
from likelihood.arms import recorded, rows_of, wrong_robot
from likelihood.fits import OPTIONS, URDF, at_joint, fitted, with_friction
from simulated import joint_names

from torchrbd.likelihood.additions import Additions
from torchrbd.likelihood.extra import Extra
from torchrbd.likelihood.learning import learn
from torchrbd.likelihood.likelihood import Likelihood
from torchrbd.likelihood.machine import Machine


def bump(m):
    return np.exp(-(((m.q[:, 1] - np.median(m.q[:, 1])) / 0.2) ** 2))


@pytest.fixture(scope="module")
def fit() -> Likelihood:
    """With friction of any sign."""
    fit = fitted(at_joint(1, bump))
    return fit.with_(resists=np.zeros_like(fit.hyper.resists))


@pytest.fixture(scope="module")
def extras(fit: Likelihood) -> list[Extra]:
    q = fit.machine.rows.q
    knots = np.quantile(q[1], np.linspace(0, 1, 6))
    curve = np.exp(-(((q[1] - knots[:, None]) / 0.2) ** 2))
    return [
        Extra(1, q[1:] ** 3, np.array([0.5])),
        Extra(1, curve, np.full(6, 0.3)),
        Extra(None, np.stack((q**2, q**3)), np.array([0.1, 0.2])),
    ]


def test_evidence_and_coefficients_are_those_of_the_whole_model(fit: Likelihood, extras: list[Extra]) -> None:
    small, whole, base = Additions(fit, extras), fit.extended(extras), fit.extended(())
    assert len(small) == 3
    assert small.log_evidence == pytest.approx(whole.log_evidence - base.log_evidence, abs=1e-4)
    np.testing.assert_allclose(small.friction, whole.friction, rtol=1e-5, atol=1e-8)
    for k in range(3):
        np.testing.assert_allclose(small.coefficients(k), whole.coefficients(k), rtol=1e-5, atol=1e-9)
        np.testing.assert_allclose(small.covariance(k), whole.coefficients_covariance(k), rtol=1e-5, atol=1e-12)


def test_components_of_a_model_are_known_from_its_moments(fit: Likelihood, extras: list[Extra]) -> None:
    whole = fit.extended(extras).rescaled({1: 0.2})
    got, expected = Additions.of(whole), Additions(fit, whole.extra)
    assert len(got) == 3
    assert got.log_evidence == pytest.approx(expected.log_evidence, rel=1e-8)
    assert got.resistance == pytest.approx(expected.resistance, rel=1e-6)
    np.testing.assert_allclose(got.friction, expected.friction, rtol=1e-6, atol=1e-10)
    for k in range(3):
        np.testing.assert_allclose(got.coefficients(k), expected.coefficients(k), rtol=1e-6, atol=1e-12)
        np.testing.assert_allclose(got.covariance(k), expected.covariance(k), rtol=1e-6, atol=1e-14)
    with pytest.raises(AssertionError, match="moments"):
        got.with_(extras[:1])


def test_resistance_is_that_of_draws(fit: Likelihood, extras: list[Extra]) -> None:
    """A component that is friction itself leaves the sign of the machine's friction open."""
    at = fit.machine.friction.index
    own = Extra(1, fit.machine.rows.qd[1:], np.array([3.0]))
    for chosen in ([], [*extras, own]):
        g = fit.extended(chosen).gaussian
        std = np.sqrt(g.covariance(at).diagonal())
        draws = g.z[at] + std * np.random.default_rng(0).standard_normal((200_000, len(at)))
        expected = np.log(2.0 * (draws >= 0).mean(0)).sum()
        assert Additions(fit, chosen).resistance == pytest.approx(expected, abs=0.02)
    assert Additions(fit, [own]).resistance < Additions(fit).resistance - 0.1


def test_components_come_go_and_change_size_without_the_rows(fit: Likelihood, extras: list[Extra]) -> None:
    base = fit.extended(())

    def expected(chosen: list[Extra]) -> float:
        return fit.extended(chosen).log_evidence - base.log_evidence

    one, two, three = extras
    by_one = Additions(fit, [one]).with_([two]).with_([three])
    assert by_one.log_evidence == pytest.approx(Additions(fit, extras).log_evidence, abs=1e-6)
    assert by_one.without(1).log_evidence == pytest.approx(expected([one, three]), abs=1e-4)
    assert by_one.without(1).coefficients(1) == pytest.approx(np.zeros(6))
    larger = Extra(1, two.features, 3.0 * two.std)
    assert by_one.rescaled({1: 3.0}).log_evidence == pytest.approx(expected([one, larger, three]), abs=1e-4)
    assert Additions(fit).log_evidence == 0.0


def test_amplitudes_are_the_likeliest(fit: Likelihood, extras: list[Extra]) -> None:
    """Those of a search on a grid; where the data need no amplitude it is small."""
    start = Additions(fit, extras)
    found = start.likeliest([1])
    grid = [start.rescaled({1: ratio}).log_evidence for ratio in np.geomspace(1e-3, 1e3, 121)]
    assert found.log_evidence > max(grid) - 0.15
    assert start.likeliest([]) is start
    np.testing.assert_array_equal(found.std[found.at(0)], start.std[start.at(0)])
    noise = Extra(0, np.random.default_rng(0).normal(size=(5, fit.machine.rows.q.shape[1])), np.full(5, 1.0))
    needless = start.with_([noise]).likeliest([3])
    assert needless.std[needless.at(3)].max() < 0.1


def test_columns_at_a_joint_without_torque_are_worth_nothing() -> None:
    silent = recorded(URDF, 2, with_friction(), missing=[joint_names(URDF)[1]], **OPTIONS)
    fit = learn(Machine(rows_of(wrong_robot(URDF, 1), [silent])))
    found = Additions(fit, [Extra(1, fit.machine.rows.q[1:] ** 3, np.ones(1))])
    assert found.log_evidence == pytest.approx(0.0, abs=1e-9)
    assert (found.coefficients(0), found.covariance(0)) == (0.0, 1.0)


def test_components_that_are_integrated_out_count_as_before(fit: Likelihood, extras: list[Extra]) -> None:
    """Amplitudes, evidence, friction and its signs of the small model are those of the model with all components."""
    whole = Additions(fit, [*extras, Extra(0, fit.machine.rows.q[:1] ** 2, np.ones(1))]).without(3)
    small = whole.around([1, 0])
    assert len(small) == len(whole)
    assert [small.has(k) for k in range(4)] == [True, True, True, False]
    for a, b in (
        (small, whole),
        (small.without(1), whole.without(1)),
        (small.rescaled({0: 2.0}), whole.rescaled({0: 2.0})),
        (small.likeliest([1]), whole.likeliest([1])),
    ):
        assert a.log_evidence == pytest.approx(b.log_evidence, abs=1e-7)
        assert a.resistance == pytest.approx(b.resistance, abs=1e-7)
        np.testing.assert_allclose(a.friction, b.friction, rtol=1e-8)
        for k in (0, 1):
            np.testing.assert_allclose(a.coefficients(k), b.coefficients(k), rtol=1e-7, atol=1e-12)
            np.testing.assert_allclose(a.covariance(k), b.covariance(k), rtol=1e-7, atol=1e-14)
            assert a.evidence_for(k) == pytest.approx(b.evidence_for(k), abs=1e-7)
