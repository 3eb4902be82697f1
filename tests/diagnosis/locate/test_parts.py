"""The pieces of the search against formulas written out, and against independent libraries."""

from __future__ import annotations

from dataclasses import replace
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from diagnosis.locate.field import CONCEALED, background, case
from scipy.stats import multivariate_normal

from torchrbd.diagnosis import Diagnosis, Location, Where
from torchrbd.diagnosis.locate.clock import Clock
from torchrbd.diagnosis.locate.intervals import best_interval, signal_interval
from torchrbd.diagnosis.locate.maps import residual_maps
from torchrbd.diagnosis.locate.scene import Scene
from torchrbd.diagnosis.locate.signals import Bases, Signal, smooth
from torchrbd.diagnosis.rows.regression import Extra, Fit, fitted
from torchrbd.diagnosis.rows.white_rows import Rows
from torchrbd.report.inline import inline, page_style
from torchrbd.report.maps import map_figure


@pytest.fixture(scope="module")
def fit() -> Fit:
    return background(case(60, CONCEALED["sticky"]))


@pytest.fixture(scope="module")
def scene(fit: Fit) -> Scene:
    return Scene.of(fit)


def covariance(fit: Fit) -> np.ndarray:
    """Return that of the whitened torque: white noise, and what the priors of all coefficients make of it."""
    return np.eye(len(fit.e)) + fit.X @ fit.X.T


def stacked(fit: Fit, joint: int, A: np.ndarray) -> np.ndarray:
    """Return features (K, M) of a joint as columns (N, K) of all rows."""
    C = np.zeros((len(fit.e), len(A)))
    C[fit.rows.parts[joint]] = fit.rows.white(A, joint).T
    return C


def test_equations_are_those_of_the_marginal_likelihood(fit: Fit) -> None:
    A = np.random.default_rng(0).standard_normal((3, len(fit.rows.samples.t)))
    C, S = stacked(fit, 2, A), covariance(fit)
    G, alone, u = fit.equations({2: A})
    np.testing.assert_allclose(G, C.T @ np.linalg.solve(S, C), rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(alone, C.T @ C)
    np.testing.assert_allclose(u, C.T @ np.linalg.solve(S, fit.rows.y), rtol=1e-5, atol=1e-4)
    np.testing.assert_allclose(fit.projected(C), np.linalg.solve(S, C), atol=1e-7)


def test_further_features_are_fitted_beside_the_terms(fit: Fit) -> None:
    """A torque that is added at one joint, and one that is added at all, is taken by features of their form."""
    rows, rng = fit.rows, np.random.default_rng(2)
    samples = rows.samples
    alone, common = rng.standard_normal((1, len(samples.t))), rng.standard_normal((1, *samples.tau.shape))
    tau = samples.tau + 3.0 * common[0]
    tau[1] += 2.0 * alone[0]
    changed = Rows(replace(samples, tau=tau), rows.prior, rows.noise)
    with_them = Fit(changed, fit.terms, [Extra(1, alone), Extra(None, common)])
    before = fitted(samples, rows.prior, fit.terms, rows.noise, [Extra(1, alone), Extra(None, common)], rounds=0)
    w = (with_them.x - before.x)[-2:] * [*changed.widths(1, alone), *changed.widths(None, common)]
    np.testing.assert_allclose(w, [2.0, 3.0], rtol=2e-3)
    np.testing.assert_allclose(with_them.residual(), before.residual(), atol=0.02 * np.std(fit.residual()))


def test_the_best_interval_is_that_of_a_loop_over_all(fit: Fit) -> None:
    samples = fit.rows.samples
    v, phi = samples.q[1], np.stack((np.ones(len(samples.t)), samples.direction[1]))
    edges = np.quantile(v, [0.0, 0.2, 0.3, 0.4, 0.5, 0.6, 0.8])
    allowed = np.triu(np.ones((7, 7), dtype=bool), 1)
    allowed[2] = False
    found = best_interval(fit, {1: phi}, edges, (v >= edges[:, None]).astype(float), allowed, 12)
    looped = {}
    for low, high in np.argwhere(allowed):
        G, _, u = fit.equations({1: phi * ((v >= edges[low]) & (v < edges[high]))})
        looped[edges[low], edges[high]] = 0.5 * u @ np.linalg.solve(G, u) - np.log(fit.rows.counts[1]) - np.log(12)
    best = max(looped, key=lambda key: looped[key])
    assert (found.low, found.high) == best
    assert found.gain == pytest.approx(looped[best], rel=0.01, abs=0.01)


def test_evidence_is_that_of_a_gaussian_process(fit: Fit, scene: Scene) -> None:
    """It is the ratio of two Gaussian densities of the torque, the function's weights as wide as the data wants."""
    joint, signal = 1, Signal("q_joint2", "level", scene.samples.q[1], 6)
    found = smooth(fit, scene, joint, signal)
    A = stacked(fit, joint, signal.columns(scene, joint))
    L = np.linalg.cholesky(covariance(fit))
    F, z = np.linalg.solve(L, A / np.linalg.norm(A, axis=0)), np.linalg.solve(L, fit.rows.y)
    Q = np.linalg.qr(np.concatenate((F, z[:, None]), axis=1))[0]
    F, z = Q.T @ F, Q.T @ z
    null = multivariate_normal.logpdf(z, cov=np.eye(len(z)))
    spread = (multivariate_normal.logpdf(z, cov=np.eye(len(z)) + t * F @ F.T) for t in np.geomspace(1e-4, 1e6, 401))
    tried = [density - null for density in spread]
    assert found.gain == pytest.approx(max(*tried, 0.0), rel=0.05, abs=0.05)


def test_signals_side_by_side_are_those_alone(fit: Fit, scene: Scene) -> None:
    together = list(Bases(scene, 0).smooths(fit))
    for one in together[::5]:
        alone = smooth(fit, scene, 0, one.signal)
        assert one.gain == pytest.approx(alone.gain, rel=1e-6, abs=1e-6)
        np.testing.assert_allclose(one.mean, alone.mean, atol=1e-6)


def test_a_step_is_placed_between_samples(fit: Fit, scene: Scene) -> None:
    clock, rows = Clock(scene), fit.rows
    edge = 12.345
    height = scene.since(rows.samples.t - edge)
    assert scene.since(np.array([-1e3, 0.0, 1e3])) == pytest.approx([0.0, 0.5, 1.0], abs=1e-6)
    tau = rows.samples.tau + np.std(rows.samples.tau, 1, keepdims=True) * height
    changed = fitted(replace(rows.samples, tau=tau), rows.prior, fit.terms)
    found = clock.scan(changed, {0: np.ones((1, len(height)))})
    recording, span = clock.place(found)
    assert recording == "field"
    assert span is not None
    assert min(abs(span[0] - edge), abs(span[1] - edge)) < 0.1
    window = clock.window(found)
    assert {round(window.start_s, 2), round(window.end_s, 2)} & set(span)


def test_an_interval_that_reaches_the_end_is_open(fit: Fit) -> None:
    v = fit.rows.samples.q[0]
    found = signal_interval(fit, 0, np.ones((1, len(v))), v)
    assert np.isinf(found.high) or found.high <= v.max()
    assert 3 <= found.inside(v).sum() < len(v)


def test_torques_of_loads_and_forces_are_those_of_the_jacobian(scene: Scene) -> None:
    """A force at a body's origin is held by a unit mass's weight, by another formula."""
    np.testing.assert_allclose(scene.held[:, :, 0], -scene.pressed[:, :, :3], atol=1e-9)
    assert scene.robot.body_names[scene.outermost] in scene.robot.body_names[-2:]


def test_a_map_is_drawn_with_a_row_per_joint_and_a_frame(fit: Fit, scene: Scene) -> None:
    joints = scene.robot.joint_names
    where = Where(time_s=((10.0, 14.0),))
    here = Location("m", joints[:1], (), where, ("t",), "level", "abrupt", 20.0, {}, {}, None, None)
    left = fit.residual()
    for one in residual_maps(scene, left, left.std(1), "m"):
        with page_style():
            figure = map_figure(one, joints, [here], ["rad"] * len(joints))
            ET.fromstring(inline(figure, "map", "k"))
        (axes,) = figure.axes
        assert [t.get_text() for t in axes.get_yticklabels()] == list(joints)
        assert sum(patch.get_linewidth() > 0 for patch in axes.patches) == (one.signal == "t")
        assert np.nanmax(one.level) > 1.0


def test_a_diagnosis_without_locations_is_still_one() -> None:
    assert Diagnosis.__dataclass_fields__["locations"].default == ()
