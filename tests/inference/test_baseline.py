"""The baseline is what anybody fits first: weighted least squares with friction, by Pinocchio and numpy."""

from __future__ import annotations

from pathlib import Path

import against_least_squares as benchmark
import numpy as np
import pinocchio as pin
import pytest
import torch
from inference.problems import urdf_of
from simulated import Motion, joint_names, record, with_wrong_inertials

import torchrbd
from torchrbd.inference.baseline import fit_baseline
from torchrbd.inference.preparation import Prepared, prepare
from torchrbd.inference.settings import Settings
from torchrbd.parameters import PARAMETERS_PER_BODY, is_physical
from torchrbd.recordings import Filtering, Recording, survey, tiles
from torchrbd.robot import RobotModel

pytestmark = pytest.mark.usefixtures("fit_alone")

URDF = urdf_of(2, 3)
GIVEN = with_wrong_inertials(URDF, 1)
NAMES = joint_names(URDF)
VISCOUS, COULOMB, OFFSET = np.array([0.6, 0.9, 0.3]), np.array([1.0, 2.0, 0.5]), np.array([0.3, -0.2, 0.1])
NOISE, RATE_HZ = 0.02, 200.0


def rubbed(m: Motion) -> np.ndarray:
    return VISCOUS * m.qd + COULOMB * np.tanh(m.qd / 1e-3) + OFFSET


@pytest.fixture(scope="module")
def recording() -> Recording:
    return record(URDF, 4, extra=rubbed, torque_noise=NOISE, rate_hz=RATE_HZ)


@pytest.fixture(scope="module")
def found(recording: Recording) -> torchrbd.Identification:
    return torchrbd.identify(GIVEN, recording)


def columns(recording: Recording, cutoff_hz: float, width: np.ndarray) -> np.ndarray:
    """Return Pinocchio's regressor and columns of friction, at the rows of a recording's torque, (M, n, p).

    Args:
        recording: what is read.
        cutoff_hz: of its states and torques.
        width: (n,) velocities within which friction changes its sign.
    """
    model = pin.buildModelFromXML(GIVEN)
    data = model.createData()
    (states,) = tiles(recording, survey(recording), Filtering(cutoff_hz), 10**7)
    motion = [x.T.numpy() for x in (states.q, states.qd, states.qdd)]
    rows = np.stack([pin.computeJointTorqueRegressor(model, data, *row).copy() for row in zip(*motion, strict=True)])
    friction = [np.eye(3) * x[:, None] for x in (motion[1], np.tanh(motion[1] / width), np.ones_like(motion[1]))]
    every = np.concatenate((rows, *friction), 2)
    flat = states.decimate(torch.from_numpy(every.reshape(len(every), -1).T.copy())).numpy().T
    return flat.reshape(-1, *every.shape[1:])


def prepared_with(recording: Recording, **options: object) -> Prepared:
    return prepare(RobotModel.from_urdf(GIVEN), [recording], Settings.from_mapping(options, "test"), ())


def test_it_is_weighted_least_squares_with_friction(recording: Recording, found: torchrbd.Identification) -> None:
    width = np.array([scale.rest_width for scale in prepared_with(recording).columns.scales])
    series, W = found.series, columns(recording, found.cutoff_hz, width)
    fitted, unseen = ~series.held_out, series.held_out
    x = benchmark.weighted(W[fitted], series.measured[fitted])
    expected = benchmark.nmse([series.measured[unseen] - W[unseen] @ x], [series.measured[unseen]])
    told = found.fits["baseline"].nmse
    assert [told[name] for name in series.joints] == pytest.approx(list(expected), rel=1e-3)
    rms = np.sqrt(np.mean(series.measured**2, axis=0))
    assert (np.abs(series.predicted["baseline"] - W @ x).max(axis=0) < 1e-3 * rms).all()


def test_its_error_is_the_noise_where_friction_is_all_that_the_urdf_lacks(
    recording: Recording, found: torchrbd.Identification
) -> None:
    (chunk,) = recording.chunks(10**6)
    noise = NOISE * np.sqrt(np.mean(chunk.tau**2, axis=0) * 2.0 * found.cutoff_hz / RATE_HZ)
    told = found.fits["baseline"]
    assert [told.rmse[name] for name in NAMES] == pytest.approx(list(noise), rel=0.25)
    assert all(told.nmse[name] < 0.01 * found.fits["urdf"].nmse[name] for name in NAMES)


def test_it_is_the_same_whatever_else_is_fitted(recording: Recording, found: torchrbd.Identification) -> None:
    alone = torchrbd.identify(GIVEN, recording, effects=[])
    assert list(alone.fits) == ["urdf", "baseline", "rigid_body"]
    assert alone.fits["baseline"] == found.fits["baseline"]


def test_a_trusted_link_stays_as_it_is(recording: Recording) -> None:
    robot = RobotModel.from_urdf(GIVEN)
    trusted = robot.body_names[0]
    free, held = (
        fit_baseline(prepared_with(recording, **some)).pi.detach().reshape(-1, PARAMETERS_PER_BODY)
        for some in ({}, {"trust": [trusted]})
    )
    given = robot.pi.reshape(-1, PARAMETERS_PER_BODY)
    torch.testing.assert_close(held[0], given[0], rtol=1e-12, atol=1e-14)
    assert not torch.allclose(free[0], given[0], rtol=1e-3)
    assert not torch.allclose(held[1:], given[1:], rtol=1e-3)


def test_bodies_need_not_be_possible() -> None:
    """Torque of the opposite sign is that of negative masses."""
    (chunk,) = record(URDF, 4).chunks(10**6)
    turned = Recording.from_arrays("day", NAMES, chunk.t, chunk.q, -chunk.tau)
    found = torchrbd.identify(GIVEN, turned)
    bodies = fit_baseline(prepared_with(turned)).pi.detach().reshape(-1, PARAMETERS_PER_BODY)
    assert not is_physical(bodies).any()
    assert found.fits["baseline"].mean_nmse < 1e-3 < 0.1 < found.fits["rigid_body"].mean_nmse


def test_there_is_none_of_moments_alone(recording: Recording, tmp_path: Path) -> None:
    (tmp_path / "arm.urdf").write_text(GIVEN)
    (chunk,) = recording.chunks(10**6)
    np.savez(tmp_path / "day.npz", t=chunk.t, q=chunk.q, tau=chunk.tau, joints=np.array(NAMES))
    made = torchrbd.write_statistics(tmp_path / "arm.urdf", tmp_path / "day.npz", tmp_path / "stats", cutoff_hz=5.0)
    found = torchrbd.identify(tmp_path / "arm.urdf", made)
    assert list(found.fits) == ["urdf", "rigid_body", "extended"]
    assert "baseline" not in found.series.predicted
    torchrbd.write_report(found, tmp_path / "report.html")
    assert "least squares with friction" not in (tmp_path / "report.html").read_text()
