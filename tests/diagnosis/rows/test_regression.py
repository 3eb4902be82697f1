"""Rows, fits and additions against plain least squares on the same columns."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from robot.random_robots import random_urdf
from simulated import record

from torchrbd.dataset.block_statistics import filtered_rows
from torchrbd.diagnosis.rows.gain import gain
from torchrbd.diagnosis.rows.regression import Fit, fitted
from torchrbd.diagnosis.rows.samples import Samples, read_samples
from torchrbd.effects import Site, effect
from torchrbd.inference.preparation import Prepared, prepare
from torchrbd.inference.settings import Settings
from torchrbd.robot import RobotModel

FRICTION = ("viscous_friction", "coulomb_friction")


@pytest.fixture(scope="module")
def prepared() -> Prepared:
    urdf = random_urdf(3, 4, kinds=("revolute",), branching=0.0, massless=0.0)
    recording = record(urdf, 3, duration_s=20.0, extra=lambda motion: 0.3 * motion.qd)
    return prepare(RobotModel.from_urdf(urdf), [recording], Settings.from_mapping({}, "test"), ())


@pytest.fixture(scope="module")
def samples(prepared: Prepared) -> Samples:
    return read_samples(prepared, prepared.fit().pi)


@pytest.fixture(scope="module")
def fit(prepared: Prepared, samples: Samples) -> Fit:
    terms = [samples.columns.candidate(effect(name), Site(joint), {}) for joint in range(3) for name in FRICTION]
    return fitted(samples, prepared.prior, terms)


def added(samples: Samples, name: str, joint: int, **shape: float):
    return samples.columns.candidate(effect(name), Site(joint), shape)


def test_with_every_link_trusted_nothing_is_imitated() -> None:
    """Without columns a fit leaves the torque as it is."""
    urdf = random_urdf(5, 3, kinds=("revolute",), branching=0.0, massless=0.0)
    robot = RobotModel.from_urdf(urdf)
    settings = Settings.from_mapping({"trust": robot.body_names}, "test")
    held = prepare(robot, [record(urdf, 5, duration_s=15.0)], settings, ())
    samples = read_samples(held, held.fit().pi)
    fit = fitted(samples, held.prior, ())
    assert fit.X.shape[1] == 0
    np.testing.assert_array_equal(fit.e, fit.rows.y)


def test_samples_are_the_rows_of_the_statistics_without_held_out_ones(prepared: Prepared, samples: Samples) -> None:
    candidate = added(samples, "coulomb_friction", 1)
    columns, (states,) = samples.columns.of_candidates([candidate], None), list(prepared.tiles(0))
    kept = ~prepared.kept_back(states.recording, states.t_out)
    rows, torque = filtered_rows(columns, states)
    assert samples.tau.shape[1] == int(kept.sum()) < len(kept)
    np.testing.assert_allclose(samples.tau, torque[:, kept].numpy(), atol=1e-12)
    own = columns.of_joint[1].tolist()
    np.testing.assert_allclose(samples.rigid[1][:, own[0]], rows[1][0, kept].numpy(), atol=1e-9)
    label = own.index(columns.of(candidate)[0])
    np.testing.assert_allclose(samples.features(candidate)[0], rows[1][label, kept].numpy(), atol=2e-3)


def test_a_coarser_clock_leaves_features_as_they_are(prepared: Prepared) -> None:
    (states,) = list(prepared.tiles(0))
    for step in (d for d in (2, 3, 4, 5) if states.stride % d == 0):
        thin = states.thinned(step)
        assert len(thin.t) == pytest.approx(len(states.t) / step, abs=1)
        for signal in ("q", "qd", "qdd"):
            fine, coarse = (s.decimate(getattr(s, signal)) for s in (states, thin))
            assert float((fine - coarse).abs().max()) < 2e-3 * float(fine.abs().max())


def test_runs_end_where_blocks_are_held_out(samples: Samples) -> None:
    step = np.diff(samples.t)
    same = np.diff(samples.run) == 0
    assert np.ptp(step[same]) < 1e-9 < 1.5 * step[same].max() < step[~same].min()


def test_a_fit_is_ridge_regression_in_prior_coordinates(fit: Fit) -> None:
    P = fit.X.shape[1]
    X, y = np.concatenate((fit.X, np.eye(P))), np.concatenate((fit.rows.y, np.zeros(P)))
    np.testing.assert_allclose(fit.x, np.linalg.lstsq(X, y, rcond=None)[0], atol=1e-8)
    np.testing.assert_allclose(fit.e, fit.rows.y - fit.X @ fit.x, atol=1e-9)


def test_the_leftover_is_that_of_the_torques(fit: Fit, samples: Samples) -> None:
    left = fit.residual()
    for j, index in enumerate(fit.rows.index):
        filters, scale = fit.rows.noise[0][j], fit.rows.noise[1][j]
        white = left[j, index] - sum(a * left[j, index - i] for i, a in enumerate(filters, start=1))
        np.testing.assert_allclose(white / scale, fit.e[fit.rows.parts[j]], atol=1e-8)
    assert 0.75 < np.std(fit.e) < 1.05


def test_features_of_the_load_are_built_anew_and_others_kept(samples: Samples) -> None:
    loaded, plain = added(samples, "load_dependent_friction", 1), added(samples, "viscous_friction", 1)
    before = samples.features(loaded), samples.features(plain)
    heavier = samples.around(2.0 * samples.columns.pi)
    np.testing.assert_allclose(heavier.features(loaded), 2.0 * before[0], rtol=1e-9)
    assert heavier.features(plain) is before[1]


def test_friction_is_seen_by_effects_on_the_torque(samples: Samples) -> None:
    """Beside the load, band-limited alike, and in the range that limits are sought in."""
    pi, friction = samples.columns.pi, torch.zeros(4, 3, dtype=torch.float64)
    friction[1] = torch.tensor([0.4, 2.0, -0.3])
    rubbed = samples.around(pi, friction)
    added = rubbed.supplied(pi, friction) - samples.supplied(pi, None)
    expected = 0.4 * samples.qd[1] + 2.0 * samples.direction[1] - 0.3
    np.testing.assert_allclose(added, np.eye(4)[1][:, None] * expected, atol=1e-9)
    limit = 1e-9  # beyond which lies all
    found, before = (
        s.features(s.columns.candidate(effect("torque_saturation"), Site(1), {"limit": limit}))[0]
        for s in (rubbed, samples)
    )
    np.testing.assert_allclose(found - before, expected, atol=2e-2)
    scales = rubbed.columns.scales, samples.columns.scales
    assert scales[0][1].load_max == pytest.approx(np.abs(rubbed.supplied(pi, friction)[1]).max())
    assert scales[0][0].load_max == pytest.approx(scales[1][0].load_max)
    assert torch.equal(samples.columns.around(pi, friction).sticking(torch.ones(4)).friction, friction)


def test_weights_take_samples_away(fit: Fit, prepared: Prepared, samples: Samples) -> None:
    half = samples.t < np.median(samples.t)
    spoiled = replace(samples, tau=samples.tau + 5.0 * half, weight=np.where(half, 1e-6, 1.0) * samples.weight)
    clean = fitted(replace(samples, weight=np.where(half, 1e-6, 1.0) * samples.weight), prepared.prior, fit.terms)
    np.testing.assert_allclose(fitted(spoiled, prepared.prior, fit.terms).pi, clean.pi, rtol=0.02, atol=0.02)


def test_gain_is_the_log_ratio_of_errors_and_its_scatter() -> None:
    rng = np.random.default_rng(0)
    before, counts = rng.uniform(9.0, 11.0, (40, 2)), np.array([400, 400])
    found = gain(before, 0.5 * before, counts)
    assert found.total == pytest.approx(2 * 200 * np.log(2.0))
    assert found.t > 30
    assert found.repeated == pytest.approx(found.total * 38 / 40, rel=0.01)
    one = before.copy()
    one[7] *= 0.1
    single = gain(before, one, counts)
    assert single.total > 5
    assert single.t < 1.5
    assert abs(single.repeated) < 1e-9
