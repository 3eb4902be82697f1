"""Check the columns and rows of ordinary physics: which rows are noisier, drift, and rounding of the torque."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from likelihood.arms import recorded, rows_of
from likelihood.fits import DELAY_S, OPTIONS, URDF, carried, fitted, with_friction
from scipy.stats import norm

from torchrbd.likelihood.learning import learn
from torchrbd.likelihood.machine import Machine
from torchrbd.nuisance.directions import STICKS
from torchrbd.recordings import Recording
from torchrbd.robot import RobotModel

ROBOT = RobotModel.from_urdf(URDF)


@pytest.fixture(scope="module")
def machine() -> Machine:
    return fitted(delay_s=DELAY_S).machine


@pytest.mark.parametrize("share", [0.0, 0.4, 1.0])
def test_encoder_noise_is_multiplied_by_the_mass_matrix(machine: Machine, share: float) -> None:
    rows = machine.rows
    M = rows.columns.robot.mass_matrix(torch.from_numpy(rows.q.T)).numpy()
    for j in range(2):
        noisy = ((M[:, j] * rows.encoder_std) ** 2).sum(1)
        expected = np.sqrt(1.0 - share + share * noisy / noisy.mean())
        np.testing.assert_allclose(machine.noise.spread(j, share), expected, rtol=1e-9)
        assert np.mean(machine.noise.spread(j, share) ** 2) == pytest.approx(1.0)


def direction_std(qd: torch.Tensor, speed_std: float) -> torch.Tensor:
    """Return the standard deviation of the sign of a velocity that is known to a normal error."""
    p = norm.cdf(qd.numpy() / speed_std)
    return torch.from_numpy(2.0 * np.sqrt(p * norm.sf(qd.numpy() / speed_std)))


def test_rows_are_noisier_where_the_velocity_does_not_tell_the_direction(machine: Machine) -> None:
    rows = machine.rows
    slow = int(np.argmin(np.abs(rows.qd[0])))
    fast = np.abs(rows.qd[0]) > 0.5 * np.sqrt(np.mean(rows.qd[0] ** 2))
    for stick in STICKS:
        wrong = rows.evaluated(lambda s, k=stick: direction_std(s.qd[0], k * rows.speed_std[0]))
        spread = machine.noise.spread(0, 0.0, 20.0, stick)
        np.testing.assert_allclose(spread, np.sqrt(1.0 + (20.0 * wrong) ** 2), rtol=1e-9)
        assert (machine.noise.spread(0, 0.0, 0.0, stick) == 1.0).all()
        assert spread[slow] >= np.median(spread[fast])
        np.testing.assert_allclose(spread[fast], 1.0, atol=0.01)
    assert machine.noise.spread(0, 0.0, 20.0, 10.0).mean() > machine.noise.spread(0, 0.0, 20.0, 1.0).mean()


def test_drift_is_a_random_walk_that_every_recording_has_alone() -> None:
    rows = rows_of(ROBOT, [recorded(URDF, k, with_friction(), name=f"r{k}", **OPTIONS) for k in (2, 3)])
    machine = Machine(rows)
    hyper = fitted(delay_s=DELAY_S).hyper
    A, own = machine.design(1, hyper, None)
    A *= machine.sizes(1, own, hyper)[:, None]
    drift = A[np.isin(own, machine.drift.at(1))] / hyper.drift[1]
    here = np.array([d[rows.recording == 0].any() for d in drift])
    assert (here ^ np.array([d[rows.recording == 1].any() for d in drift])).all()
    for inside, number in ((here, 0), (~here, 1)):
        size = np.abs(drift[inside][:, rows.recording == number]).max(1)
        np.testing.assert_allclose(size, [1.0, *(1.0 / np.arange(1, inside.sum()))], rtol=0.01)


def quantised(step: float) -> Recording:
    """Record an arm without torque noise; the second joint's torque is rounded."""
    (chunk,) = recorded(URDF, 2, with_friction(), noise=0.0, **OPTIONS).chunks(10**7)
    tau = chunk.tau.copy()
    tau[:, 1] = step * np.round(tau[:, 1] / step)
    return Recording.from_arrays("rounded", ROBOT.joint_names, chunk.t, chunk.q, tau)


def test_torque_is_told_to_be_rounded() -> None:
    rows = rows_of(ROBOT, [quantised(0.25)])
    assert np.isnan(rows.torque_step[0])
    assert rows.torque_step[1] == pytest.approx(0.25, rel=1e-3)


def test_rounding_is_a_sawtooth_of_the_torque() -> None:
    """The first harmonic of round(x) - x is -(D / pi) sin(2 pi x / D): its coefficient is -1, that of the cosine 0."""
    fit = learn(Machine(rows_of(ROBOT, [quantised(0.25)])))
    rounding = fit.machine.along(fit.hyper)["rounding"]
    rows, step = carried(fit), float(fit.machine.rows.torque_step[1])
    sine = rows.evaluated(lambda s: (step / np.pi) * torch.sin(2 * np.pi * s.supplied[1] / step))
    # Its load is that of a fit just before.
    np.testing.assert_allclose(rounding[0, 1], sine, atol=1e-2 * step)
    assert not rounding[:, 0].any()
    A, own = fit.machine.design(1, fit.hyper, along=fit._along)
    assert fit._along is not None
    at = [k for k, row in zip(own, A, strict=True) for s in fit._along["rounding"][:, 1] if np.array_equal(row, s)]
    assert fit.gaussian.z[at[0]] == pytest.approx(-1.0, abs=0.15)
    assert abs(fit.gaussian.z[at[1]]) < 0.15
    assert fit.gaussian.against(at) > 30
