"""Hausman's test: uniform where the model is right, small where its law is wrong."""

from __future__ import annotations

from copy import copy
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from likelihood.fits import at_joint, fitted, tail_of
from scipy.signal import lfilter
from scipy.stats import chi2, kstest

from torchrbd.likelihood.likelihood import Likelihood
from torchrbd.likelihood.misspecification import MISFIT, TwoEstimates, remembered
from torchrbd.likelihood.noise import Noise
from torchrbd.nuisance.component import Along

# So coloured that least squares loses something in every direction.
PREDICTOR, SIGMA, DRAWS = np.array([1.5, -0.7]), 0.01, 300


@lru_cache(maxsize=1)
def right() -> Likelihood:
    """Return a likelihood whose noise is autoregressive and whose prior is N(0, 1)."""
    fit = fitted()
    one = np.ones(len(fit.machine.rows.t))
    noise = tuple(
        Noise(i, PREDICTOR, SIGMA * rms, one) for i, rms in zip(fit.index, fit.machine.torque_rms, strict=True)
    )
    plain = {"bodies": np.zeros_like(fit.hyper.bodies), "resists": np.zeros_like(fit.hyper.resists)}
    hyper = fit.hyper.with_(noise=noise, dispersion=np.ones(2), **plain)
    return Likelihood(fit.machine, hyper, along=fit.machine.along(hyper))


@lru_cache(maxsize=1)
def along_of() -> Along:
    return right().machine.along(right().hyper)


def drawn(fit: Likelihood, rng: np.random.Generator, bend: float = 0.0) -> Likelihood:
    """Return the same likelihood of torques drawn from it, with a curve over velocity at the first joint."""
    z, target = rng.standard_normal(len(fit.gaussian.z)), fit.machine.target.copy()
    for j, noise in enumerate(fit.hyper.noise):
        e = lfilter([noise.sigma], [1.0, *-noise.predictor], rng.standard_normal(target.shape[1] + 500))[500:]
        target[j] = z[fit.gaussian.blocks[j].own] @ fit.columns(j) + e
    qd = fit.machine.rows.qd[0]
    target[0] += bend * fit.machine.torque_rms[0] * qd * np.abs(qd) / np.mean(qd**4) ** 0.5
    machine = copy(fit.machine)
    machine.target = target
    return Likelihood(machine, fit.hyper, along=along_of())


def test_p_values_are_uniform_where_the_model_is_right() -> None:
    fit, rng = right(), np.random.default_rng(0)
    tests = [TwoEstimates(drawn(fit, rng)) for _ in range(DRAWS)]
    for index in (fit.machine.friction.at(0), fit.machine.friction.at(1), np.arange(20), fit.machine.clocks.index):
        found = [two.test(index) for two in tests]
        assert {one.dof for one in found} == {found[0].dof}
        assert found[0].dof > 0
        assert kstest([one.p_value for one in found], "uniform").pvalue > 0.01


def test_least_squares_is_plain_whatever_the_noise() -> None:
    """Rows that count little by their tails count as all others: least squares is what predicts."""
    fit = drawn(right(), np.random.default_rng(6))
    rare = np.where(np.random.default_rng(7).random(len(fit.machine.rows.t)) < 0.5, 1e-3, 1.0)
    heavy = fit.with_(noise=tuple(replace(n, tail=tail_of(rare)) for n in fit.hyper.noise))
    plain, other = TwoEstimates(fit), TwoEstimates(heavy)
    at = fit.machine.friction.at(0)
    std = np.sqrt(plain.estimate(at)[1].diagonal())
    assert (np.abs(other.ordinary - plain.ordinary)[at] < 0.1 * std).all()
    assert (np.abs(other.efficient - plain.efficient)[at] > 0.1 * std).any()


def test_the_efficient_estimate_is_the_posterior_mean_and_both_agree_on_average() -> None:
    fit, rng = right(), np.random.default_rng(1)
    draws = [drawn(fit, rng) for _ in range(DRAWS)]
    tests, at = [TwoEstimates(one) for one in draws], fit.machine.friction.at(0)
    for one, two in zip(draws[:3], tests[:3], strict=True):
        np.testing.assert_allclose(two.efficient, one.gaussian.z, atol=1e-6)
    apart = np.array([(two.ordinary - two.efficient)[at] for two in tests])
    assert (np.abs(apart.mean(0)) < 4.0 * apart.std(0) / DRAWS**0.5).all()


def test_a_curve_over_velocity_that_is_left_out_is_seen_most_at_its_joint() -> None:
    fit, rng = right(), np.random.default_rng(2)
    tests = [TwoEstimates(drawn(fit, rng, bend=0.3)) for _ in range(20)]
    found = np.array([[two.test(fit.machine.friction.at(j)).statistic for j in range(2)] for two in tests])
    assert all(two.test(fit.machine.friction.at(0)).p_value < MISFIT for two in tests)
    # What it bends in the bodies, which both joints carry, is seen at the other one too.
    assert (found[:, 0] > found[:, 1]).all()


def test_learnt_noise_is_not_taken_for_a_wrong_law() -> None:
    for seed in (2, 3, 4):
        two = TwoEstimates(fit := fitted(seed=seed))
        assert min(two.test(fit.machine.friction.at(j)).p_value for j in range(2)) > MISFIT


@pytest.mark.parametrize("exponent", [0.5, 2.0, 3.0])
def test_a_law_that_is_wrong_is_seen_in_noise_that_is_learnt(exponent: float) -> None:
    law = at_joint(0, lambda m: np.sign(m.qd[:, 0]) * np.abs(m.qd[:, 0]) ** exponent)
    two = TwoEstimates(fit := fitted(law))
    assert two.test(fit.machine.friction.at(0)).p_value < MISFIT


def test_where_the_two_disagree_the_truth_may_be_either() -> None:
    fit, rng = right(), np.random.default_rng(5)
    bent, well = TwoEstimates(other_law := drawn(fit, rng, bend=0.3)), TwoEstimates(one := drawn(fit, rng))
    at, other = fit.machine.friction.at(0), fit.machine.clocks.index
    (mean, C), apart = bent.estimate(at), (bent.ordinary - bent.efficient)[at]
    np.testing.assert_allclose(mean, bent.efficient[at] + 0.5 * apart)
    assert (C.diagonal() >= 0.25 * apart**2).all()
    # The efficient estimate is sure that the other one is wrong; between them nothing is.
    alone = other_law.gaussian.against(at, bent.ordinary[at])
    assert alone > 10.0 > bent.against(at, bent.ordinary[at])
    assert well.test(other).p_value >= MISFIT
    np.testing.assert_allclose(well.estimate(other)[1], one.gaussian.covariance(other))
    assert well.against(other) == pytest.approx(one.gaussian.against(other))


def test_memory_is_that_of_the_noise() -> None:
    rng, run = np.random.default_rng(3), np.repeat([0, 1], [30, 50])
    noise = Noise(np.arange(80), PREDICTOR, 0.7, rng.uniform(0.5, 1.5, 80))
    U = rng.standard_normal((4, 80))
    memory, before = remembered(U, noise, run)
    # Of each run alone, as a dense covariance of a long noise's end.
    expected = np.zeros((4, 4))
    for k in (0, 1):
        own, early = run == k, 400
        own_std = noise.sigma * noise.spread[own]
        std = np.concatenate((np.full(early, own_std[0]), own_std))
        G = lfilter([1.0], [1.0, *-PREDICTOR], np.eye(len(std)), axis=0)[early:] * std
        expected += U[:, own] @ G @ G.T @ U[:, own].T
        np.testing.assert_allclose(memory[:, own], (U[:, own] @ G)[:, early:], atol=1e-9)
    np.testing.assert_allclose(memory @ memory.T + before, expected, rtol=1e-5)


def test_white_noise_leaves_nothing_to_compare() -> None:
    fit = right()
    noise = tuple(replace(n, predictor=np.zeros(0)) for n in fit.hyper.noise)
    one = drawn(Likelihood(fit.machine, fit.hyper.with_(noise=noise), along=along_of()), np.random.default_rng(4))
    found = TwoEstimates(one).test(fit.machine.friction.at(0))
    assert found.p_value == pytest.approx(chi2.sf(found.statistic, found.dof) if found.dof else 1.0)
    assert found.p_value > MISFIT


def test_no_coefficients_are_no_question() -> None:
    with pytest.raises(ValueError, match="no coefficients"):
        TwoEstimates(right()).test([])
