"""The pieces of the search against formulas written out, and against independent libraries."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from diagnosis.locate.field import CONCEALED, case
from scipy.signal import lfilter
from scipy.stats import multivariate_normal

from torchrbd.diagnosis import Diagnosis, Location, Where
from torchrbd.diagnosis.locate import Rows, read_rows
from torchrbd.diagnosis.locate.intervals import Clock, best_interval, signal_interval
from torchrbd.diagnosis.locate.residual import ORDER, Leftover, fit_rows, whitened
from torchrbd.diagnosis.locate.signals import Signal, smooth
from torchrbd.inference.preparation import prepare
from torchrbd.inference.settings import Settings
from torchrbd.report.inline import inline, page_style
from torchrbd.report.maps import map_figure
from torchrbd.robot import RobotModel


@pytest.fixture(scope="module")
def rows() -> Rows:
    one = case(60, CONCEALED["sticky"])
    prepared = prepare(RobotModel.from_urdf(one.cad), [one.recording], Settings.from_mapping({}, "test"), ())
    return read_rows(prepared, prepared.fit().pi)


@pytest.fixture(scope="module")
def leftover(rows: Rows) -> Leftover:
    return fit_rows(rows)


def dense(rows: Rows, leftover: Leftover) -> tuple[np.ndarray, np.ndarray, list[int]]:
    """Stack the whitened regression of all joints, sample by sample; returns columns, torque and rows per joint."""
    M, n = rows.tau.shape
    columns, torque, count = [], [], []
    for j in range(n):
        own = np.zeros((M, sum(o.shape[1] for o in rows.own)))
        first = sum(o.shape[1] for o in rows.own[:j])
        own[:, first : first + rows.own[j].shape[1]] = rows.own[j]
        D = np.concatenate((rows.rigid[j], own), axis=1)
        kept = 0
        for k in range(ORDER, M):
            if rows.run[k] == rows.run[k - ORDER]:
                past = sum(leftover.filters[j, i] * D[k - 1 - i] for i in range(ORDER))
                columns.append((D[k] - past) / leftover.scale[j])
                past = sum(leftover.filters[j, i] * rows.tau[k - 1 - i, j] for i in range(ORDER))
                torque.append((rows.tau[k, j] - past) / leftover.scale[j])
                kept += 1
        count.append(kept)
    return np.stack(columns), np.array(torque), count


def test_held_out_samples_are_not_among_the_rows(rows: Rows) -> None:
    assert len(np.unique(rows.run)) > 1
    assert np.diff(rows.t)[np.diff(rows.run) > 0].min() > 1.5 * rows.dt
    np.testing.assert_allclose(np.diff(rows.t)[np.diff(rows.run) == 0], rows.dt, rtol=1e-6)


def test_leftover_and_equations_are_those_of_one_dense_regression(rows: Rows, leftover: Leftover) -> None:
    D, y, count = dense(rows, leftover)
    U = np.linalg.svd(D / np.linalg.norm(D, axis=0).clip(1e-12), full_matrices=False)[0]
    rank = leftover.basis[0].shape[1]
    P = U[:, :rank] @ U[:, :rank].T
    np.testing.assert_allclose(np.concatenate(leftover.e), y - P @ y, atol=1e-6 * np.abs(y).max())
    A = np.random.default_rng(0).standard_normal((len(rows.t), 3))
    at = slice(sum(count[:2]), sum(count[:3]))
    stacked = np.zeros((len(y), 3))
    stacked[at] = leftover.white(2, A)
    G, alone, u = leftover.equations({2: leftover.white(2, A)})
    np.testing.assert_allclose(G, stacked.T @ (stacked - P @ stacked), rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(alone, stacked.T @ stacked)
    np.testing.assert_allclose(u, stacked.T @ (y - P @ y), rtol=1e-5, atol=1e-4)


def test_whitened_coloured_noise_is_white(leftover: Leftover) -> None:
    white = np.random.default_rng(1).standard_normal(4000)
    a = np.array([0.9, -0.4, 0.1, 0.05])
    coloured = lfilter([1.0], [1.0, *-a], white)
    index = np.arange(ORDER, 4000)
    np.testing.assert_allclose(whitened(coloured, index, a, 2.0), white[ORDER:] / 2, atol=1e-12)
    e = np.concatenate(leftover.e)
    assert np.mean(e**2) == pytest.approx(1 - np.concatenate(leftover.basis).shape[1] / len(e), rel=0.1)


def test_the_best_interval_is_that_of_a_loop_over_all(rows: Rows, leftover: Leftover) -> None:
    v, phi = rows.q[:, 1], np.stack((np.ones(len(rows.t)), rows.direction[:, 1]), axis=1)
    lows, highs = np.quantile(v, [0.0, 0.2, 0.4, 0.6]), np.quantile(v, [0.3, 0.5, 0.8])
    steps = (v[:, None] >= np.concatenate((lows, highs))).astype(float)
    found = best_interval(leftover, {1: phi}, steps, lows, highs, np.ones((4, 3), dtype=bool), 12)
    looped = {}
    for low in lows:
        for high in highs:
            if low < high:
                A = leftover.white(1, phi * ((v >= low) & (v < high))[:, None])
                G, _, u = leftover.equations({1: A})
                looped[low, high] = 0.5 * u @ np.linalg.solve(G, u) - np.log(len(A)) - np.log(12)
    best = max(looped, key=lambda key: looped[key])
    assert (found.low, found.high) == best
    assert found.gain == pytest.approx(looped[best], rel=0.01, abs=0.01)


def test_evidence_is_that_of_a_gaussian_process(rows: Rows, leftover: Leftover) -> None:
    """It is the ratio of two Gaussian densities of the leftover, in the space that the fit leaves."""
    joint, signal = 1, Signal("q_joint2", "level", rows.q[:, 1], 6)
    found = smooth(leftover, joint, signal)
    D, _, count = dense(rows, leftover)
    at = slice(count[0], count[0] + count[1])
    A = np.zeros((len(D), 6))
    A[at] = leftover.white(joint, signal.columns(rows, joint))
    A = A / np.linalg.norm(A, axis=0)
    Q = np.concatenate(leftover.basis)
    A = A - Q @ (Q.T @ A)
    e = np.concatenate(leftover.e)
    basis = np.linalg.qr(np.concatenate((A, e[:, None]), axis=1))[0][:, :7]
    F, z = basis.T @ A, basis.T @ e
    null = multivariate_normal.logpdf(z, cov=np.eye(7))
    best = max(multivariate_normal.logpdf(z, cov=np.eye(7) + t * F @ F.T) - null for t in np.geomspace(1e-4, 1e6, 401))
    assert found.gain == pytest.approx(max(best, 0.0), rel=0.05, abs=0.05)


def test_a_step_is_placed_between_samples(rows: Rows) -> None:
    clock = Clock(rows)
    edge = 12.345
    height = rows.since(rows.t - edge)
    assert rows.since(np.array([-1e3, 0.0, 1e3])) == pytest.approx([0.0, 0.5, 1.0], abs=1e-6)
    changed = replace(rows, tau=rows.tau + np.std(rows.tau, 0) * height[:, None])
    found = clock.scan(fit_rows(changed), {0: np.ones((len(rows.t), 1))})
    recording, span = clock.place(found)
    assert recording == "field"
    assert span is not None
    assert min(abs(span[0] - edge), abs(span[1] - edge)) < 0.1


def test_an_interval_that_reaches_the_end_is_open(rows: Rows, leftover: Leftover) -> None:
    found = signal_interval(leftover, 0, np.ones((len(rows.t), 1)), rows.q[:, 0])
    assert np.isinf(found.high) or found.high <= rows.q[:, 0].max()
    assert 3 <= found.inside(rows.q[:, 0]).sum() < len(rows.t)


def test_a_map_is_drawn_with_a_row_per_joint_and_a_frame(rows: Rows, leftover: Leftover, tmp_path: Path) -> None:
    from torchrbd.diagnosis.locate.maps import leftover_maps

    joints = rows.robot.joint_names
    where = Where(time_s=((10.0, 14.0),))
    here = Location("m", joints[:1], (), where, ("t",), "level", "abrupt", 20.0, {}, {}, None, None, "x")
    for one in leftover_maps(leftover, leftover, "m"):
        with page_style():
            figure = map_figure(one, joints, [here], ["rad"] * len(joints))
            ET.fromstring(inline(figure, "map", "k"))
        (axes,) = figure.axes
        assert [t.get_text() for t in axes.get_yticklabels()] == list(joints)
        assert len(axes.patches) == (one.signal == "t")
        assert np.nanmax(one.level) > 1.0


def test_a_diagnosis_without_locations_is_still_one() -> None:
    assert Diagnosis.__dataclass_fields__["locations"].default == ()
