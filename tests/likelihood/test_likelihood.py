"""Check what is learnt of an arm whose friction, clock and noise are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from likelihood.arms import none_kept_back, recorded, rows_of, wrong_robot
from likelihood.fits import COULOMB, DELAY_S, OPTIONS, URDF, VISCOUS, WIDTH, candidate, carried, fitted, with_friction

from torchrbd.likelihood.columns import Columns
from torchrbd.likelihood.gaussian import added
from torchrbd.likelihood.likelihood import Extra, Likelihood
from torchrbd.likelihood.machine import RESPONSE_ORDERS, STICKS, Machine
from torchrbd.likelihood.noise import learnt
from torchrbd.physics import Site
from torchrbd.robot import RobotModel


@pytest.fixture(scope="module")
def fit() -> Likelihood:
    return fitted(delay_s=DELAY_S)


def friction_std(fit: Likelihood) -> np.ndarray:
    """Return posterior standard deviations of viscous and both Coulomb coefficients, (n, 3)."""
    machine, found = fit.machine, []
    for j in range(2):
        prior = machine.friction_std(j, machine.friction_columns(j, float(fit.hyper.rest_width[j])))
        found.append(np.sqrt(fit.gaussian.covariance(machine.ordinary(j)).diagonal()) * prior)
    return np.array(found)


def test_friction_lies_within_its_intervals(fit: Likelihood) -> None:
    expected = np.stack((VISCOUS, COULOMB, COULOMB), 1)
    assert (np.abs(fit.friction - expected) < 3.5 * friction_std(fit)).all()
    assert (friction_std(fit) < 0.05 * expected).all()
    np.testing.assert_allclose(fit.hyper.rest_width, WIDTH, rtol=0.3)


def test_delay_lies_within_its_interval(fit: Likelihood) -> None:
    std = fit.machine.timing_std * np.sqrt(fit.gaussian.covariance(fit.machine.timing).diagonal())
    assert abs(fit.delay_s[0] - DELAY_S) < 3.5 * std[0]
    assert std[0] < 0.05 * DELAY_S


def test_noise_is_that_of_the_torque(fit: Likelihood) -> None:
    """The reference is learnt of the torque's noise itself, as the filter leaves it."""
    quiet = rows_of(wrong_robot(URDF, 1), [recorded(URDF, 2, with_friction(), noise=0.0, delay_s=DELAY_S, **OPTIONS)])
    rows = fit.machine.rows
    for j, e in enumerate(rows.tau - quiet.tau):
        noise = learnt(e, np.ones(len(e)), np.ones(len(e)), rows.run, rows.measured[j], 0.0, 1.0)
        assert fit.hyper.noise[j].sigma == pytest.approx(noise.sigma, rel=0.1)
    assert (fit.hyper.dispersion < 1.3).all()


def test_residual_is_what_the_coefficients_leave(fit: Likelihood) -> None:
    machine, z = fit.machine, fit.gaussian.z
    for j in range(2):
        A, own = machine.design(j, fit.hyper, fit._slopes)
        np.testing.assert_allclose(fit.residual(j), machine.target[j] - z[own] @ A, atol=1e-9)
        white = fit.hyper.noise[j].white(fit.residual(j), fit.index[j])
        np.testing.assert_allclose(white, fit.gaussian.left[j], atol=1e-9)
        assert white.var() == pytest.approx(1.0, rel=0.15)


def test_urdf_errs_as_much_as_the_evidence_says(fit: Likelihood) -> None:
    """Masses and centres are a tenth off, which is kappa = 100."""
    assert 10.0 <= fit.hyper.kappa <= 300.0
    best = fit.log_evidence
    assert best > fit._with(kappa=1e-1).log_evidence + 10
    assert best > fit._with(kappa=1e4).log_evidence + 10


def test_evidence_favours_the_widths_and_the_noise_that_were_learnt(fit: Likelihood) -> None:
    for factor in (0.3, 3.0):
        assert fit._with(rest_width=factor * fit.hyper.rest_width).log_evidence < fit.log_evidence - 5
        noise = tuple(replace(n, sigma=factor * n.sigma) for n in fit.hyper.noise)
        assert fit._with(noise=noise).log_evidence < fit.log_evidence - 5


@pytest.fixture(scope="module")
def scaled() -> Likelihood:
    return fitted(gain=10.0, delay_s=DELAY_S)


def test_units_of_the_torque_scale_what_is_learnt(fit: Likelihood, scaled: Likelihood) -> None:
    np.testing.assert_allclose(scaled.friction, 10 * fit.friction, rtol=0.01)
    np.testing.assert_allclose(scaled.delay_s, fit.delay_s, rtol=0.01)
    np.testing.assert_allclose(scaled.pi, 10 * fit.pi, rtol=1e-3, atol=1e-3 * float(fit.pi.abs().max()))
    assert scaled.hyper.kappa == fit.hyper.kappa
    for one, other in zip(scaled.hyper.noise, fit.hyper.noise, strict=True):
        assert one.sigma == pytest.approx(10 * other.sigma, rel=0.01)


def test_differences_of_evidence_do_not_depend_on_the_torques_unit(fit: Likelihood, scaled: Likelihood) -> None:
    """Nor where the models compared have noises of other orders: every model explains the same rows."""

    def differences(one: Likelihood) -> list[float]:
        shorter = tuple(replace(n, predictor=n.predictor[:1]) for n in one.hyper.noise)
        others = one._with(kappa=1.0), one._with(noise=shorter)
        return [o.log_evidence - one.log_evidence for o in others]

    np.testing.assert_allclose(differences(scaled), differences(fit), rtol=0.01, atol=0.3)


def test_rows_that_count_do_not_depend_on_the_order_of_the_noise(fit: Likelihood) -> None:
    none = tuple(replace(n, predictor=np.zeros(0)) for n in fit.hyper.noise)
    for one, other in zip(fit._with(noise=none).index, fit.index, strict=True):
        np.testing.assert_array_equal(one, other)


def test_columns_beside_raise_the_evidence_by_what_was_said(fit: Likelihood) -> None:
    rows = carried(fit)
    for place, c in ((1, candidate(rows, "quadratic_drag", Site(1))), (None, candidate(rows, "base_tilt", Site()))):
        F = rows.features(c)
        std = 0.1 * np.ones(len(F))
        one = added(*fit.beside(place, F), std)
        beside = fit.extended([Extra(place, F, std)])
        assert beside.log_evidence - fit.log_evidence == pytest.approx(one.log_evidence, abs=1e-6)
        np.testing.assert_allclose(beside.coefficients(0), one.mean, rtol=1e-6, atol=1e-12)
        np.testing.assert_allclose(beside.coefficients_std(0), one.std, rtol=1e-6)
        assert beside.against_leaving_out(0) == pytest.approx(one.log_evidence, abs=1e-6)


def test_features_are_judged_together_as_one_by_one(fit: Likelihood) -> None:
    rows = carried(fit)
    parts = [rows.features(candidate(rows, "torque_ripple", Site(0), order=m)) for m in (3.0, 5.0, 8.0)]
    S, r = fit.beside(0, np.concatenate(parts))
    for k, F in enumerate(parts):
        here = slice(2 * k, 2 * k + 2)
        one, score = fit.beside(0, F)
        np.testing.assert_allclose(S[here, here], one, rtol=1e-9)
        np.testing.assert_allclose(r[here], score, rtol=1e-9, atol=1e-9)


def test_dispersion_is_one_for_white_rows_and_more_for_errors_that_last(fit: Likelihood) -> None:
    rng = np.random.default_rng(0)
    one, rows = fit.extended(()), fit.machine.rows
    g = one.gaussian
    n = len(g.left[0])
    white = [rng.normal(size=n) for _ in range(20)]
    found = []
    for e in white:
        g.left[0] = e
        found.append(one.dispersion(0))
    assert np.mean(found) == pytest.approx(1.0, abs=0.15)
    block = np.unique(rows.block[one.index[0]], return_inverse=True)[1]
    g.left[0] = white[0] * np.exp(rng.normal(size=block.max() + 1))[block] + rng.normal(size=block.max() + 1)[block]
    assert one.dispersion(0) > 2.0
    assert fit.extended(()).dispersion(0) == pytest.approx(fit.dispersion(0))


def test_dispersed_rows_count_less(fit: Likelihood) -> None:
    F = np.sin(np.arange(len(fit.machine.rows.t)) / 7.0)[None]
    S, _ = fit.beside(0, F)
    base = fit.hyper.dispersion
    T, _ = fit.dispersed(4.0 * base).beside(0, F)
    assert T[0, 0] == pytest.approx(S[0, 0] / 4, rel=0.2)
    again = fit.dispersed(4.0 * base).dispersed(base)
    assert again.log_evidence == pytest.approx(fit.log_evidence)


def test_recording_without_a_joints_torque_does_not_shrink_what_is_believed_of_it() -> None:
    """Of how large coefficients of a joint may be, a recording that does not measure its torque says nothing."""
    robot = RobotModel.from_urdf(URDF)
    one = recorded(URDF, 2, with_friction(), name="one", **OPTIONS)
    other = recorded(URDF, 2, with_friction(), name="other", missing=[robot.joint_names[1]], **OPTIONS)
    alone, both = Machine(rows_of(robot, [one])), Machine(rows_of(robot, [one, other], none_kept_back))
    np.testing.assert_allclose(both.torque_rms, alone.torque_rms, rtol=1e-3)


def test_machine_of_trusted_bodies_has_friction_alone() -> None:
    rows = rows_of(RobotModel.from_urdf(URDF), [recorded(URDF, 2, with_friction(), duration_s=5.0, rate_hz=100.0)])
    machine = Machine(rows, frozenset(rows.columns.robot.body_names))
    A, own = machine.design(0, fitted(delay_s=DELAY_S).hyper, None)
    assert len(A) == len(own)
    assert own.min() == 0
    assert machine.n == 2 * (4 + len(RESPONSE_ORDERS) + 2 + len(machine.drifting(0))) + 1
    assert isinstance(rows.columns, Columns)
