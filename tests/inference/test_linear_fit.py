"""The linear fit in prior coordinates, its noise levels, and the prior behind it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from inference.problems import FILTERING, columns_of, dense, prior_of, random_moments, recorded, statistics_of, urdf_of
from robot.random_robots import random_urdf
from simulated import inverse_dynamics, multisine, record

from torchrbd.dataset.columns import Columns
from torchrbd.likelihood.equations import linear_fit, residual_variance, scaled_equations, with_noise
from torchrbd.likelihood.urdf_prior import Prior, divergence_hessian, unphysical_bodies
from torchrbd.parameters import is_physical
from torchrbd.recordings import survey
from torchrbd.robot import RobotModel, pseudo_inertia, transform_inertia


def everything(columns: Columns, prior: Prior) -> torch.Tensor:
    return torch.cat((prior.inertial, torch.arange(columns.robot.n_params, columns.n)))


def test_divergence_hessian_is_that_of_minus_logdet() -> None:
    pi = RobotModel.from_urdf(urdf_of(0, 2)).pi[:10]
    expected = torch.autograd.functional.hessian(lambda pi: -pseudo_inertia(pi).logdet(), pi)
    found = divergence_hessian(torch.linalg.inv(pseudo_inertia(pi)))
    torch.testing.assert_close(found, expected, rtol=1e-8, atol=1e-8)


def test_prior_covariance_is_the_inverse_hessian_whatever_the_frame() -> None:
    robot = RobotModel.from_urdf(urdf_of(1, 2))
    columns = columns_of(robot)
    prior = prior_of(columns, kappa=5.0)
    for b, W in enumerate(prior.inverse_inertia):
        S = prior.scale[10 * b : 10 * b + 10, 10 * b : 10 * b + 10]
        precision = 5.0 * divergence_hessian(W)
        torch.testing.assert_close(S.T @ precision @ S, torch.eye(10, dtype=torch.float64), rtol=0, atol=1e-7)
    pose = torch.eye(4, dtype=torch.float64)
    pose[:3, :3], pose[:3, 3] = torch.linalg.qr(torch.randn(3, 3, dtype=torch.float64))[0], torch.tensor([0.3, 1, -2])
    change = torch.func.jacrev(lambda pi: transform_inertia(pi, pose))(robot.pi[:10])
    there = divergence_hessian(torch.linalg.inv(pseudo_inertia(transform_inertia(robot.pi[:10], pose))))
    here = divergence_hessian(prior.inverse_inertia[0])
    torch.testing.assert_close(change.T @ there @ change, here, rtol=1e-6, atol=1e-6 * float(here.abs().max()))


def test_prior_holds_trusted_and_massless_bodies_and_repairs_impossible_ones() -> None:
    robot = RobotModel.from_urdf(random_urdf(5, 4, massless=1.0, branching=0.0, fixed=0.0))
    assert prior_of(columns_of(robot)).bodies == (3,)
    robot = RobotModel.from_urdf(urdf_of(3, 3))
    robot.pi[14:20] = 0.0  # the second body becomes a point mass
    columns = columns_of(robot)
    prior = prior_of(columns, held=(robot.body_names[2],))
    assert unphysical_bodies(columns) == (robot.body_names[1],)
    assert prior.bodies == (0, 1)
    assert prior.inertial.tolist() == list(range(20))
    assert is_physical(prior.mean[:20].reshape(-1, 10)).all()
    assert torch.equal(prior.reference[: robot.n_params], robot.pi)
    assert torch.equal(prior.mean[20:30], robot.pi[20:])
    assert not prior.scale[20:30].any()


def test_solution_is_the_dense_ridge_regression() -> None:
    """min |W (tau - A x)|^2 + |P (x - x0)|^2 as one stacked least-squares problem in numpy."""
    robot, recording = recorded(2, 3, torque_noise=0.05)
    columns = columns_of(robot)
    prior, full = prior_of(columns), dense(columns, recording)
    weights = np.array([0.5, 2.0, 1.0])
    equations = scaled_equations(prior, statistics_of(columns, recording).total(), columns, torch.from_numpy(weights))
    free = everything(columns, prior)
    free = free[~torch.isin(free, torch.tensor([columns.index(0, "q"), columns.index(2, "qd")]))]
    root = np.sqrt(full.weight * weights)
    x0, S = prior.mean.numpy(), prior.scale.numpy()[:, free]
    x = x0 + S @ equations.posterior(free).z
    rows = np.concatenate([(root[j] * full.A[j]) @ S for j in range(3)] + [np.eye(len(free))])
    rest = np.concatenate([root[j] * (full.tau[j] - full.A[j] @ x0) for j in range(3)] + [np.zeros(len(free))])
    z, *_ = np.linalg.lstsq(rows, rest, rcond=None)
    np.testing.assert_allclose(x, x0 + S @ z, rtol=0, atol=1e-7 * np.abs(x0).max())
    assert x[columns.index(0, "q")] == x[columns.index(2, "qd")] == 0.0


def test_parameters_that_are_used_up_do_not_count_as_samples() -> None:
    robot, recording = recorded(2, 3, torque_noise=0.05)
    columns = columns_of(robot)
    statistics = statistics_of(columns, recording)
    x, none = columns.reference(), torch.zeros(columns.n, columns.n, dtype=torch.float64)
    variance, count = torch.ones(3, dtype=torch.float64), statistics.torque[..., 0].sum(0)
    plain = residual_variance(statistics, x, none, variance)
    torch.testing.assert_close(plain, statistics.squared_error(x).sum(0) / count)
    one = none.clone()
    k = columns.index(1, "qd")
    own = (columns.of_joint[1] == k).nonzero().item()
    one[k, k] = 1.0 / statistics.total()[1][own, own]
    corrected = residual_variance(statistics, x, one, variance)
    torch.testing.assert_close(corrected[1], plain[1] * count[1] / (count[1] - 1))
    assert corrected[0] == plain[0]
    # States use up their share of what samples count, which is little where a joint may stick.
    share = torch.tensor([0.0, 0.25, 0.5], dtype=torch.float64)
    for counted in (1.0, 0.1):
        moments = tuple(counted * m for m in statistics.moments)
        weighed = replace(statistics, torque=counted * statistics.torque, moments=moments)
        left = residual_variance(weighed, x, none, variance, share)
        torch.testing.assert_close(left, plain / (1.0 - share))


@pytest.mark.parametrize("noise", [0.01, 0.2])
def test_noise_level_is_recovered(noise: float) -> None:
    """White torque noise of variance s^2 leaves s^2 sum k^2 behind the filter k."""
    urdf = urdf_of(4, 4)
    recording = record(urdf, 4, torque_noise=noise, encoder_noise=0.0, duration_s=150.0)
    robot = RobotModel.from_urdf(urdf)
    columns = columns_of(robot, ())
    prior, statistics = prior_of(columns), statistics_of(columns, recording)
    _, found = linear_fit(statistics, prior, prior.inertial)
    clean = inverse_dynamics(urdf, multisine(4, 4, duration_s=150.0))
    kernel = FILTERING.feature_kernel(survey(recording).clock.dt).numpy()
    expected = noise**2 * np.mean(clean**2, 0) * np.sum(kernel**2)
    ratio = found.numpy() / expected
    assert np.abs(ratio - 1).max() < 0.2  # 1500 independent samples a joint: 4 % standard deviation
    assert ratio.mean() == pytest.approx(1.0, abs=0.1)


def test_noise_settles_where_the_fit_leaves_what_it_assumes() -> None:
    robot, recording = recorded(2, 3, torque_noise=0.05)
    columns = columns_of(robot)
    prior, statistics = prior_of(columns), statistics_of(columns, recording)
    free, fits = prior.inertial, []

    def fit(variance: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        equations = scaled_equations(prior, statistics.total(), columns, 1.0 / variance)
        S, covariance = prior.scale[:, free], equations.posterior(free).covariance(np.arange(len(free)))
        fits.append(variance)
        return (
            variance,
            prior.mean + S @ torch.from_numpy(equations.posterior(free).z),
            S @ torch.from_numpy(covariance) @ S.T,
        )

    assumed, variance = with_noise(statistics, fit, rounds=30, tolerance=1e-8)
    assert assumed is variance
    assert 2 < len(fits) < 30
    _, x, covariance = fit(variance)
    torch.testing.assert_close(residual_variance(statistics, x, covariance, variance), variance, rtol=1e-8, atol=0)
    _, other = linear_fit(statistics, prior, free)
    torch.testing.assert_close(other, variance, rtol=1e-2, atol=0)
    given = torch.ones(3, dtype=torch.float64)
    assert with_noise(statistics, fit, given, rounds=0)[1] is given


def test_noise_of_a_joint_without_torque_is_infinite() -> None:
    robot = RobotModel.from_urdf(urdf_of(0, 3))
    columns = columns_of(robot, ())
    statistics = random_moments(columns, 0, 100, columns.reference())
    statistics.torque[:, 1] = 0.0
    statistics.moments[1].zero_()
    _, found = linear_fit(statistics, prior_of(columns), prior_of(columns).inertial)
    assert torch.isinf(found).tolist() == [False, True, False]
    assert (found > 0).all()
