"""The physically valid fit: the minimiser of its convex objective, and a physical robot whatever the data."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.optimize
import torch
from inference.problems import columns_of, prior_of, random_moments, urdf_of
from robot.random_robots import random_urdf
from shortened import slow_but
from torch import Tensor

from torchrbd.dataset.block_statistics import BlockStatistics, assemble
from torchrbd.dataset.columns import Columns
from torchrbd.likelihood.equations import scaled_equations
from torchrbd.likelihood.physical_fit import PhysicalFit, physical_fit
from torchrbd.likelihood.urdf_prior import Prior
from torchrbd.parameters import from_log_cholesky, to_log_cholesky
from torchrbd.robot import RobotModel, from_pseudo_inertia, pseudo_inertia


def fit(columns: Columns, prior: Prior, statistics: BlockStatistics, weight: float) -> PhysicalFit:
    weights = torch.full((columns.robot.n_dof,), weight, dtype=torch.float64)
    equations = scaled_equations(prior, statistics.total(), columns, weights)
    return physical_fit(prior, equations, torch.arange(columns.robot.n_params, columns.n))


def objective(columns: Columns, prior: Prior, statistics: BlockStatistics, weight: float, x: Tensor) -> Tensor:
    """Return the objective as its docstring defines it, from the blocks' squared error."""
    J = pseudo_inertia(x[prior.inertial].reshape(-1, 10))
    trace = (prior.inverse_inertia * J.mT).sum()
    terms = slice(columns.robot.n_params, columns.n)
    ridge = ((x - prior.mean)[terms] / prior.scale.diagonal()[terms]).square().sum()
    H, h = assemble(columns, statistics.total(), torch.full((columns.robot.n_dof,), weight, dtype=torch.float64))
    return x @ H @ x / 2 - h @ x + prior.kappa * (trace - J.logdet().sum()) + ridge / 2


def least_eigenvalue(prior: Prior, found: PhysicalFit) -> float:
    return float(torch.linalg.eigvalsh(pseudo_inertia(found.x[prior.inertial].reshape(-1, 10)))[:, 0].min())


def step_left(columns: Columns, prior: Prior, statistics: BlockStatistics, w: float, found: PhysicalFit) -> float:
    """Return the norm of the Newton step that is left, in posterior standard deviations."""
    x = found.x.clone().requires_grad_()
    (slope,) = torch.autograd.grad(objective(columns, prior, statistics, w, x), x)
    slope = (prior.scale.T @ slope)[found.free]
    curvature, V = torch.linalg.eigh(found.precision)
    # Below rounding of the largest, curvature is not told from zero, nor is its sign.
    told = curvature.clamp(min=torch.finfo(curvature.dtype).eps * float(curvature.max()))
    return float((V.T @ slope / told.sqrt()).norm())


@pytest.mark.parametrize(
    ("seed", "n_joints", "weight"), slow_but([(1, 3, 0.01)], [(0, 2, 1.0), (1, 3, 0.01), (2, 2, 300.0)])
)
def test_minimiser_is_scipys(seed: int, n_joints: int, weight: float) -> None:
    """Newton's method of scipy in log-Cholesky coordinates, derivatives by autograd."""
    robot = RobotModel.from_urdf(urdf_of(seed, n_joints, fixed=0.0))
    columns = columns_of(robot, ("viscous_friction",))
    prior, statistics = prior_of(columns), random_moments(columns, seed, 40, 5.0)
    n = robot.n_params

    def of(theta: Tensor) -> Tensor:
        x = torch.cat((from_log_cholesky(theta[:n].reshape(-1, 10)).flatten(), theta[n:]))
        return objective(columns, prior, statistics, weight, x)

    def value(theta: np.ndarray) -> tuple[float, np.ndarray]:
        x = torch.from_numpy(theta).requires_grad_()
        f = of(x)
        return float(f.detach()), torch.autograd.grad(f, x)[0].numpy()

    def hessian(theta: np.ndarray) -> np.ndarray:
        return torch.autograd.functional.hessian(of, torch.from_numpy(theta)).numpy()

    start = torch.cat((to_log_cholesky(prior.mean[:n].reshape(-1, 10)).flatten(), prior.mean[n:])).numpy()
    options = {"gtol": 1e-9, "maxiter": 500}
    best = scipy.optimize.minimize(value, start, jac=True, hess=hessian, method="trust-exact", options=options)
    theta = torch.from_numpy(best.x)
    expected = torch.cat((from_log_cholesky(theta[:n].reshape(-1, 10)).flatten(), theta[n:]))
    found = fit(columns, prior, statistics, weight)
    S = prior.scale[found.free.unsqueeze(1), found.free]
    std = (S @ torch.linalg.inv(found.precision) @ S.T).diagonal().sqrt()
    assert ((found.x - expected)[found.free].abs() / std).max() < 1e-4
    assert (found.x - expected).abs().max() < 1e-5 * expected.abs().max()


def test_precision_is_the_hessian_of_the_objective() -> None:
    robot = RobotModel.from_urdf(urdf_of(1, 2))
    columns = columns_of(robot)
    prior, statistics = prior_of(columns), random_moments(columns, 1, 30, 2.0)
    found = fit(columns, prior, statistics, 0.5)
    H = torch.autograd.functional.hessian(lambda x: objective(columns, prior, statistics, 0.5, x), found.x)
    expected = (prior.scale.T @ H @ prior.scale)[found.free.unsqueeze(1), found.free]
    torch.testing.assert_close(found.precision, expected, rtol=1e-6, atol=1e-6 * float(expected.diagonal().max()))


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(("torque", "weight"), [(0.0, 1.0), (1.0, 1e-3), (1.0, 1.0), (30.0, 1.0), (1.0, 1e4)])
def test_random_moments_give_a_physical_minimiser(seed: int, torque: float, weight: float) -> None:
    robot = RobotModel.from_urdf(urdf_of(seed, 4, branching=0.5))
    columns = columns_of(robot)
    prior, statistics = prior_of(columns), random_moments(columns, seed, 50, torque)
    found = fit(columns, prior, statistics, weight)
    assert least_eigenvalue(prior, found) > 0
    assert found.converged
    assert step_left(columns, prior, statistics, weight, found) < 1e-3


@pytest.mark.parametrize("beyond", [0.0, 0.3, 1.0], ids=["on", "over", "far"])
def test_truth_on_or_over_the_boundary(beyond: float) -> None:
    robot = RobotModel.from_urdf(urdf_of(0, 3))
    columns = columns_of(robot)
    values, vectors = torch.linalg.eigh(pseudo_inertia(robot.pi.reshape(-1, 10)))
    values[:, 0] *= -beyond
    truth = columns.reference()
    truth[: robot.n_params] = from_pseudo_inertia(vectors @ torch.diag_embed(values) @ vectors.mT).flatten()
    prior, statistics = prior_of(columns), random_moments(columns, 1, 500, truth)
    for weight in (1.0, 1e3):
        found = fit(columns, prior, statistics, weight)
        assert least_eigenvalue(prior, found) > 0
        assert step_left(columns, prior, statistics, weight, found) < 1e-3


@pytest.mark.parametrize(("torque", "weight"), [(1.0, 1e8), (1e3, 1e4), (1e6, 1.0)])
def test_heavy_weights_on_impossible_torques(torque: float, weight: float) -> None:
    """Torques of no robot, trusted to 1e-4 and better."""
    robot = RobotModel.from_urdf(urdf_of(0, 3, fixed=0.0))
    columns = columns_of(robot)
    prior, statistics = prior_of(columns), random_moments(columns, 0, 50, torque)
    found = fit(columns, prior, statistics, weight)
    assert least_eigenvalue(prior, found) > 0
    assert found.converged
    assert step_left(columns, prior, statistics, weight, found) < 1e-2


def test_massless_bodies_stay_as_they_are() -> None:
    robot = RobotModel.from_urdf(random_urdf(5, 4, massless=1.0, branching=0.0, fixed=0.0))
    columns = columns_of(robot)
    prior = prior_of(columns)
    found = fit(columns, prior, random_moments(columns, 0, 50, 3.0), 1.0)
    assert torch.equal(found.x[:30], torch.zeros(30, dtype=torch.float64))
    assert least_eigenvalue(prior, found) > 0


def test_trusted_bodies_stay_and_no_data_changes_nothing() -> None:
    robot = RobotModel.from_urdf(urdf_of(2, 3))
    columns = columns_of(robot)
    prior = prior_of(columns, held=(robot.body_names[1],))
    found = fit(columns, prior, random_moments(columns, 0, 50, 3.0), 1.0)
    assert torch.equal(found.x[10:20], robot.pi[10:20])
    assert not torch.allclose(found.x[:10], robot.pi[:10])
    silent = fit(columns, prior, random_moments(columns, 0, 50, 3.0), 0.0)
    torch.testing.assert_close(silent.x, prior.mean, rtol=0, atol=1e-12)


def test_all_bodies_may_be_trusted() -> None:
    robot = RobotModel.from_urdf(urdf_of(2, 3))
    columns = columns_of(robot, ())
    prior = prior_of(columns, held=robot.body_names)
    equations = scaled_equations(prior, random_moments(columns, 0, 50).total(), columns, torch.ones(3))
    found = physical_fit(prior, equations, torch.arange(0))
    assert torch.equal(found.x[: robot.n_params], robot.pi)


def test_thirty_joints() -> None:
    robot = RobotModel.from_urdf(random_urdf(11, 30, kinds=("revolute", "prismatic")))
    columns = columns_of(robot)
    prior, statistics = prior_of(columns), random_moments(columns, 1, 60, 10.0)
    found = fit(columns, prior, statistics, 1.0)
    assert least_eigenvalue(prior, found) > 0
    assert step_left(columns, prior, statistics, 1.0, found) < 1e-3
    assert found.steps < 400


@pytest.mark.parametrize("size", [1e-2, 30.0], ids=["finger", "crane"])
def test_size_of_the_robot_does_not_matter(size: float) -> None:
    """Lengths times s, masses times s^3: pi scales by its powers of s, the columns by the inverse, torque stays."""
    powers = torch.tensor([3.0, 4, 4, 4, 5, 5, 5, 5, 5, 5], dtype=torch.float64)
    base = RobotModel.from_urdf(urdf_of(1, 3, fixed=0.0))
    columns = columns_of(base, ())
    change = torch.cat(((size**powers).repeat(3), torch.ones(columns.n - 30, dtype=torch.float64)))
    statistics = random_moments(columns, 3, 200, 0.8 * columns.reference())
    reference = fit(columns, prior_of(columns), statistics, 10.0)
    scaled = RobotModel.from_urdf(urdf_of(1, 3, fixed=0.0))
    scaled.pi.mul_(change[:30])
    other = columns_of(scaled, ())
    moments = []
    for own, m in zip(columns.of_joint, statistics.moments, strict=True):
        d = torch.cat((1 / change[own], torch.ones(1, dtype=torch.float64)))
        moments.append(d[:, None] * m * d)
    found = fit(
        other, prior_of(other), BlockStatistics(other, statistics.blocks, tuple(moments), statistics.torque), 10.0
    )
    torch.testing.assert_close(found.x / change, reference.x, rtol=0, atol=1e-5 * float(reference.x.abs().max()))
