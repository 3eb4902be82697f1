"""Check what is learnt of an arm whose friction, clock and noise are known."""

from __future__ import annotations

import gc
import weakref
from dataclasses import replace

import numpy as np
import pytest
from likelihood.arms import recorded, rows_of, wrong_robot
from likelihood.fits import (
    COULOMB,
    DELAY_S,
    OPTIONS,
    URDF,
    VISCOUS,
    WIDTH,
    at_joint,
    candidate,
    carried,
    fitted,
    tail_of,
    with_friction,
)

from torchrbd.dataset.columns import Columns
from torchrbd.effects import Site
from torchrbd.likelihood.extra import Extra
from torchrbd.likelihood.gaussian import added
from torchrbd.likelihood.learning import learn
from torchrbd.likelihood.likelihood import Likelihood
from torchrbd.likelihood.machine import Machine
from torchrbd.likelihood.noise import learnt
from torchrbd.parameters import PARAMETERS_PER_BODY, is_physical
from torchrbd.robot import RobotModel

ROBOT = RobotModel.from_urdf(URDF)


@pytest.fixture(scope="module")
def fit() -> Likelihood:
    return fitted(delay_s=DELAY_S)


def friction_std(fit: Likelihood) -> np.ndarray:
    """Return posterior standard deviations of viscous and both Coulomb coefficients, (n, 3)."""
    machine, found = fit.machine, []
    for j in range(2):
        prior = machine.friction.std(j, machine.friction.features(j, float(fit.hyper.rest_width[j])))
        found.append(np.sqrt(fit.gaussian.covariance(machine.friction.at(j)).diagonal()) * prior)
    return np.array(found)


def test_friction_lies_within_its_intervals(fit: Likelihood) -> None:
    expected = np.stack((VISCOUS, COULOMB, COULOMB), 1)
    assert (np.abs(fit.friction - expected) < 3.5 * friction_std(fit)).all()
    assert (friction_std(fit) < 0.05 * expected).all()
    np.testing.assert_allclose(fit.hyper.rest_width, WIDTH, rtol=0.3)


def test_delay_lies_within_its_interval(fit: Likelihood) -> None:
    std = fit.machine.clocks.std * np.sqrt(fit.gaussian.covariance(fit.machine.clocks.index).diagonal())
    assert abs(fit.delay_s[0] - DELAY_S) < 3.5 * std[0]
    assert std[0] < 0.06 * DELAY_S


def test_noise_is_that_of_the_torque(fit: Likelihood) -> None:
    """The reference is learnt of the torque's noise itself, as the filter leaves it."""
    quiet = rows_of(wrong_robot(URDF, 1), [recorded(URDF, 2, with_friction(), noise=0.0, delay_s=DELAY_S, **OPTIONS)])
    rows = fit.machine.rows
    for j, e in enumerate(rows.tau - quiet.tau):
        noise = learnt(e, fit.index[j], np.ones(len(e)), rows.run, 0.0, 1.0)
        assert fit.hyper.noise[j].sigma == pytest.approx(noise.sigma, rel=0.1)
    assert (fit.hyper.dispersion < 1.3).all()


def test_residual_is_what_the_coefficients_leave(fit: Likelihood) -> None:
    machine, z = fit.machine, fit.gaussian.z
    for j in range(2):
        A, own = machine.design(j, fit.hyper, fit._along)
        z_own = z[own] * machine.sizes(j, own, fit.hyper)
        np.testing.assert_allclose(fit.residual(j), machine.target[j] - z_own @ A, atol=1e-9)
        white = fit.hyper.noise[j].white(fit.residual(j))
        np.testing.assert_allclose(white, fit.gaussian.left(j), atol=1e-9)
        assert white.var() == pytest.approx(1.0, rel=0.15)


def test_urdf_errs_as_much_as_the_evidence_says(fit: Likelihood) -> None:
    """Masses and centres are a tenth off, which is kappa = 100."""
    assert 10.0 <= fit.hyper.kappa <= 300.0
    best = fit.log_evidence
    assert best > fit.with_(kappa=1e-1).log_evidence + 10
    assert best > fit.with_(kappa=1e4).log_evidence + 10


def test_evidence_favours_the_widths_and_the_noise_that_were_learnt(fit: Likelihood) -> None:
    for factor in (0.3, 3.0):
        assert fit.with_(rest_width=factor * fit.hyper.rest_width).log_evidence < fit.log_evidence - 5
        noise = tuple(replace(n, sigma=factor * n.sigma) for n in fit.hyper.noise)
        assert fit.with_(noise=noise).log_evidence < fit.log_evidence - 5


def test_a_component_is_at_the_joints_whose_torque_it_adds_to(fit: Likelihood) -> None:
    assert Extra(1, fit.machine.rows.qd[:1] ** 2, np.ones(1)).joints == [1]
    whole = np.zeros((1, *fit.machine.rows.qd.shape))
    whole[0, 0] = 1.0
    assert Extra(None, whole, np.ones(1)).joints == [0]


def test_rows_that_least_squares_sees_are_those_of_a_noise_without_memory(fit: Likelihood) -> None:
    """They are remembered for noises of other sizes, not for another spread."""
    louder = fit.renoised()
    for one in (fit, louder, fit.with_(noise=tuple(replace(n, spread=2.0 * n.spread) for n in fit.hyper.noise))):
        again = Likelihood(one.machine, one.least_squares.hyper, one.extra, fit.machine.along(fit.hyper))
        for found, wanted in zip(one.least_squares.gaussian.blocks, again.gaussian.blocks, strict=True):
            np.testing.assert_allclose(found.y, wanted.y, rtol=1e-10)
            np.testing.assert_allclose(found.gram, wanted.gram, rtol=1e-9, atol=1e-9 * np.abs(wanted.gram).max())


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
        others = one.with_(kappa=1.0), one.with_(noise=shorter)
        return [o.log_evidence - one.log_evidence for o in others]

    np.testing.assert_allclose(differences(scaled), differences(fit), rtol=0.01, atol=0.3)


def test_rows_that_count_do_not_depend_on_the_order_of_the_noise(fit: Likelihood) -> None:
    none = tuple(replace(n, predictor=np.zeros(0)) for n in fit.hyper.noise)
    for one, other in zip(fit.with_(noise=none).index, fit.index, strict=True):
        np.testing.assert_array_equal(one, other)


def test_columns_beside_raise_the_evidence_by_what_was_said(fit: Likelihood) -> None:
    rows = carried(fit)
    for place, c in ((1, candidate(rows, "quadratic_drag", Site(1))), (None, candidate(rows, "base_tilt", Site()))):
        F = rows.features(c)
        std = 0.1 * np.ones(len(F))
        one = added(*fit.precision_and_score(place, F), std)
        beside = fit.extended([Extra(place, F, std)])
        assert beside.log_evidence - fit.log_evidence == pytest.approx(one.log_evidence, abs=1e-6)
        np.testing.assert_allclose(beside.coefficients(0), one.mean, rtol=1e-6, atol=1e-12)
        at = len(beside.gaussian.z) - len(std) + np.arange(len(std))
        own = np.sqrt(beside.gaussian.covariance(at).diagonal()) * std
        np.testing.assert_allclose(own, one.std, rtol=1e-6)
        assert beside.gaussian.against(at) == pytest.approx(one.log_evidence, abs=1e-6)


def test_features_are_judged_together_as_one_by_one(fit: Likelihood) -> None:
    rows = carried(fit)
    parts = [rows.features(candidate(rows, "torque_ripple", Site(0), order=m)) for m in (3.0, 5.0, 8.0)]
    S, r = fit.precision_and_score(0, np.concatenate(parts))
    for k, F in enumerate(parts):
        here = slice(2 * k, 2 * k + 2)
        one, score = fit.precision_and_score(0, F)
        np.testing.assert_allclose(S[here, here], one, rtol=1e-9)
        np.testing.assert_allclose(r[here], score, rtol=1e-9, atol=1e-9)


def test_tails_are_as_heavy_as_what_the_posterior_leaves(fit: Likelihood) -> None:
    """What a worse fit left, at reversals, would have tails that nothing has beside the right one."""
    rng = np.random.default_rng(4)
    worse = [tail_of(5.0 / (4.0 + rng.standard_t(4.0, len(n.spread)) ** 2)) for n in fit.hyper.noise]
    heavy = fit.with_(noise=tuple(replace(n, tail=tail) for n, tail in zip(fit.hyper.noise, worse, strict=True)))
    again = heavy.levelled()
    assert all(n.tail is None for n in again.hyper.noise)
    assert again.log_evidence == pytest.approx(fit.levelled().log_evidence, abs=5.0)
    assert heavy.log_evidence < again.log_evidence - 50.0


def test_rows_that_are_kept_are_those_of_a_model_made_anew(fit: Likelihood) -> None:
    features = fit.machine.rows.q
    own = Extra(1, features[1:2] ** 3, np.ones(1))
    other = Extra(None, np.stack((features**2,)), np.ones(1))
    first = Extra(0, np.stack((features[0] ** 2, np.sin(7.0 * features[0]))), np.array([0.5, 2.0]))
    base = fit.extended([own])
    drift = fit.hyper.drift * [1.0, 2.0]
    noise = (fit.hyper.noise[0], replace(fit.hyper.noise[1], sigma=2.0 * fit.hyper.noise[1].sigma))
    changed = (
        base,
        base.extended([own, other]),
        base.extended([other]).extended([own]),
        base.with_(drift=drift, noise=noise),
        base.with_(rest_width=fit.hyper.rest_width * [1.0, 1.5]),
        base.extended([own, other]).rescaled({0: 3.0, 1: 0.2}),
        base.extended([own, other]).rescaled({1: 0.2}).renoised([0]).rescaled({0: 2.0}),
        base.extended([other, own]).extended([own]),
        base.extended([own, other, first]).renoised([1]).extended([own, first]),
        base.extended([own, first]).rescaled({1: 0.3}).extended([first]).with_(rest_width=2.0 * fit.hyper.rest_width),
        base.extended([own, first]).least_squares.extended([first]).least_squares,
        base.extended([own, first]).renoised([1]).bare,
        base.renoised([1], dispersed=True),
    )
    for one in changed:
        anew = Likelihood(one.machine, one.hyper, one.extra, one._along)
        assert one.log_evidence == pytest.approx(anew.log_evidence, rel=1e-10)
        np.testing.assert_allclose(one.gaussian.z, anew.gaussian.z, rtol=1e-6, atol=1e-9)
    assert changed[-1].hyper.noise[0].sigma == base.hyper.noise[0].sigma
    assert changed[-1].hyper.noise[1].sigma != base.hyper.noise[1].sigma


def test_dispersion_is_one_for_white_rows_and_more_for_errors_that_last(fit: Likelihood) -> None:
    rng = np.random.default_rng(0)
    one, rows = fit.extended(()), fit.machine.rows
    g = one.gaussian
    n = len(g.left(0))
    white, part = [rng.normal(size=n) for _ in range(20)], rows.block[one.index[0]]
    assert np.mean([g.dispersion(0, part, e) for e in white]) == pytest.approx(1.0, abs=0.15)
    assert g.dispersion(0, part, g.left(0)) == one.dispersion(0)
    block = np.unique(part, return_inverse=True)[1]
    lasting = white[0] * np.exp(rng.normal(size=block.max() + 1))[block] + 2.0 * rng.normal(size=block.max() + 1)[block]
    assert g.dispersion(0, part, lasting) > 2.0
    assert fit.extended(()).dispersion(0) == pytest.approx(fit.dispersion(0))


def test_dispersed_rows_count_less(fit: Likelihood) -> None:
    F = np.sin(np.arange(len(fit.machine.rows.t)) / 7.0)[None]
    S, _ = fit.precision_and_score(0, F)
    base = fit.hyper.dispersion
    T, _ = fit.dispersed(4.0 * base).precision_and_score(0, F)
    assert T[0, 0] == pytest.approx(S[0, 0] / 4, rel=0.2)
    again = fit.dispersed(4.0 * base).dispersed(base)
    assert again.log_evidence == pytest.approx(fit.log_evidence)


def test_other_sizes_are_those_of_a_model_made_anew(fit: Likelihood) -> None:
    """The URDF's error and drift change the sizes of columns alone, whatever noise there is."""
    for other in (
        fit.with_(kappa=0.3 * fit.hyper.kappa),
        fit.with_(drift=np.array([2.0, 1.0]) * fit.hyper.drift),
        fit.with_(kappa=7.0, drift=0.1 * fit.hyper.drift).dispersed(3.0 * fit.hyper.dispersion),
        fit.least_squares.with_(kappa=7.0, drift=0.1 * fit.hyper.drift),
    ):
        fresh = Likelihood(other.machine, other.hyper, along=other._along)
        assert other.log_evidence == pytest.approx(fresh.log_evidence, rel=1e-12)
        np.testing.assert_allclose(other.gaussian.z, fresh.gaussian.z, rtol=1e-6, atol=1e-9)
        for j in range(2):
            np.testing.assert_allclose(other.columns(j), fresh.columns(j), rtol=1e-14)
            np.testing.assert_allclose(other.residual(j), fresh.residual(j), atol=1e-9)
            at, size = other.gaussian.blocks[j], np.abs(fresh.gaussian.blocks[j].X).max()
            np.testing.assert_allclose(at.X, fresh.gaussian.blocks[j].X, atol=1e-13 * size)


def test_machine_of_trusted_bodies_has_friction_alone() -> None:
    rows = rows_of(RobotModel.from_urdf(URDF), [recorded(URDF, 2, with_friction(), duration_s=5.0, rate_hz=100.0)])
    machine = Machine(rows, frozenset(rows.columns.robot.body_names))
    A, own = machine.design(0, fitted(delay_s=DELAY_S).hyper, None)
    assert len(A) == len(own)
    assert own.min() == 0
    rests = sum(len(machine.rests.at(j)) for j in range(2))
    assert machine.n == 2 * (10 + 2 + len(machine.drift.at(0)) + 2) + 2 + rests
    assert isinstance(rows.columns, Columns)


def test_bodies_are_physical_and_the_prior_is_expanded_there(fit: Likelihood) -> None:
    assert is_physical(fit.pi.reshape(-1, PARAMETERS_PER_BODY)).all()
    again = fit.relinearised()
    np.testing.assert_allclose(again.pi, fit.pi, rtol=0.02, atol=0.02 * float(fit.pi.abs().max()))
    z = again.gaussian.z[: len(again.hyper.bodies)]
    np.testing.assert_allclose(z, np.sqrt(again.hyper.kappa) * again.hyper.bodies, atol=0.3)


def test_friction_that_is_not_there_does_not_push() -> None:
    """A joint without friction has coefficients around zero whose truncated posterior is not negative."""
    robot = wrong_robot(URDF, 1)
    fit = learn(Machine(rows_of(robot, [recorded(URDF, 2, **{**OPTIONS, "noise": 0.2})])))
    found = fit.machine.friction.of(fit.gaussian.z, fit.hyper)
    assert (found > 0).all()
    assert (found < 4 * friction_std(fit)).all()
    assert (fit.hyper.resists[0] >= 0).all()
    assert fit.hyper.resists[0].max() > 0


def test_slow_change_is_drift_and_nothing_else(fit: Likelihood) -> None:
    """An offset that wanders changes neither friction nor clocks, and the drift's size is learnt of it."""
    walk = fitted(at_joint(0, lambda m: 0.5 * np.sin(2 * np.pi * 0.04 * m.t + 0.3)), delay_s=DELAY_S)
    assert walk.hyper.drift[0] > 5 * fit.hyper.drift[0]
    assert (np.abs(walk.friction - fit.friction) < 3 * np.hypot(friction_std(walk), friction_std(fit))).all()
    assert abs(walk.delay_s[0] - DELAY_S) < 3e-4


def test_a_model_is_freed_as_soon_as_nothing_needs_it() -> None:
    """Its rows are large: they must not wait for the collector of cycles."""
    recording = recorded(URDF, 2, with_friction(), **OPTIONS)
    gc.disable()
    try:
        fit = learn(Machine(rows_of(wrong_robot(URDF, 1), [recording])))
        assert fit.refit.least_squares.with_heavy_tails().friction.shape == (2, 3)
        watched = weakref.ref(fit), weakref.ref(fit.machine), weakref.ref(fit.refit)
        del fit
        assert [one() for one in watched] == [None, None, None]
    finally:
        gc.enable()
