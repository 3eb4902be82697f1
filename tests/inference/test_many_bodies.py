"""Physically valid fits of large trees, half of whose joints hardly move: physical, and at the minimum."""

from __future__ import annotations

import numpy as np
import physical_fit as benchmark
import pytest
import torch
from inference.problems import columns_of, prior_of
from inference.test_physical_fit import fit, least_eigenvalue, step_left
from robot.random_robots import random_urdf
from torch import Tensor

from torchrbd.dataset.block_statistics import Block, BlockStatistics
from torchrbd.dataset.columns import Columns
from torchrbd.parameters import from_log_cholesky, is_physical, to_log_cholesky
from torchrbd.robot import RobotModel

SHARE_MOVING, STILL = 0.5, 1e-4


def another_robot(pi: Tensor, seed: int, size: float = 0.3) -> Tensor:
    """Return physical bodies (n, 10) whose log-Cholesky coordinates are off by ``size``; massless ones stay."""
    heavy = pi[:, 0] > 0
    theta = to_log_cholesky(pi[heavy])
    step = size * torch.from_numpy(np.random.default_rng(seed).normal(size=theta.shape))
    changed = pi.clone()
    changed[heavy] = from_log_cholesky(theta + step * torch.tensor([1.0] * 4 + [0.1] * 6))
    return changed


def badly_excited(columns: Columns, pi: Tensor, seed: int, samples: int, noise: float) -> BlockStatistics:
    """Return moments of random states, half of the joints almost at rest; ``noise`` is part of each torque's RMS."""
    robot, rng = columns.robot, np.random.default_rng(seed)
    size = np.where(rng.random(robot.n_dof) < SHARE_MOVING, 1.0, STILL)
    q, qd, qdd = (torch.from_numpy(a * size * rng.normal(size=(samples, robot.n_dof))) for a in (1.5, 1.0, 3.0))
    Y = robot.regressor(q, qd, qdd)
    torque = Y @ pi.flatten()
    torque = torque + noise * torque.square().mean(0).sqrt() * torch.from_numpy(rng.normal(size=torque.shape))
    moments, torques = [], []
    for j, own in enumerate(columns.of_joint):
        features = qd[:, j, None].expand(-1, len(own) - len(columns.inertial[j]))
        a = torch.cat((Y[:, j, columns.inertial[j]], features, torque[:, j, None]), 1)
        moments.append((a.T @ a)[None])
        torques.append(torch.stack((torch.tensor(float(samples)).double(), a[:, -1].sum(), a[:, -1].square().sum())))
    return BlockStatistics(columns, (Block("random", 0.0, 1.0),), tuple(moments), torch.stack(torques)[None])


def large(seed: int, n_joints: int) -> tuple[RobotModel, Columns]:
    robot = RobotModel.from_urdf(random_urdf(seed, n_joints, kinds=("revolute", "prismatic"), massless=0.15))
    assert (robot.pi.reshape(-1, 10)[:, 0] == 0).any()
    return robot, columns_of(robot, ())


@pytest.mark.parametrize(
    ("weight", "noise"), [(1e6, 0.0), (1.0, 0.1), *(pytest.param(w, 0.0, marks=pytest.mark.slow) for w in (1.0, 1e3))]
)
def test_sixty_bodies_half_of_them_hardly_moving(weight: float, noise: float) -> None:
    robot, columns = large(21, 60)
    prior = prior_of(columns)
    truth = another_robot(robot.pi.reshape(-1, 10), 3)
    statistics = badly_excited(columns, truth, 4, 2000, noise)
    found = fit(columns, prior, statistics, weight)
    assert least_eigenvalue(prior, found) > 0
    assert is_physical(found.x[prior.inertial].reshape(-1, 10)).all()
    assert found.converged
    if weight < 1e6:  # With more information than 1e13 prior precisions the objective itself is rounded off.
        assert step_left(columns, prior, statistics, weight, found) < 1e-2


@pytest.mark.parametrize("weight", [1e3, 1e9])
@pytest.mark.parametrize("noise", [0.0, 3.0])
def test_torques_of_no_robot_give_a_robot(weight: float, noise: float) -> None:
    """Truth outside the set of physical bodies, or torque that is mostly noise, believed to many digits."""
    robot, columns = large(22, 25)
    prior = prior_of(columns)
    impossible = another_robot(robot.pi.reshape(-1, 10), 5)
    impossible[:, 4:] *= 0.1
    assert not is_physical(impossible).all()
    found = fit(columns, prior, badly_excited(columns, impossible, 6, 500, noise), weight)
    pi = found.x[prior.inertial].reshape(-1, 10)
    assert least_eigenvalue(prior, found) > 0
    assert is_physical(pi).all()
    torch.testing.assert_close(from_log_cholesky(to_log_cholesky(pi)), pi, rtol=0, atol=1e-9 * float(pi.abs().max()))


def test_noiseless_torques_of_a_large_robot_are_reproduced() -> None:
    """Judged by states of other moving joints than fitted: only combinations that the data tells may agree."""
    robot, columns = large(23, 40)
    prior = prior_of(columns)
    truth = another_robot(robot.pi.reshape(-1, 10), 7)
    statistics = badly_excited(columns, truth, 8, 3000, 0.0)
    found = fit(columns, prior, statistics, 1e6)
    error, size = statistics.squared_error(found.x).sum(0), statistics.torque[0, :, 2]
    assert float((error / size).max()) < 1e-8


@pytest.mark.slow
def test_a_hundred_bodies() -> None:
    robot, columns = large(31, 100)
    prior = prior_of(columns)
    statistics = badly_excited(columns, another_robot(robot.pi.reshape(-1, 10), 1), 2, 3000, 0.0)
    found = fit(columns, prior, statistics, 1e6)
    assert found.converged
    assert least_eigenvalue(prior, found) > 0


@pytest.mark.slow
def test_half_the_joints_hardly_moving_judged_on_other_motions() -> None:
    """The table of the benchmark, on robots and seeds that nothing was tried on."""
    names = (
        "ridge to the URDF",
        "ARD, projection by relevance",
        "OLS, projection in Gram metric",
        "physical fit, kappa 3",
    )
    errors: dict[str, list[float]] = {name: [] for name in names}
    for robot in range(201, 205):
        urdf = random_urdf(robot, 7, kinds=("revolute",), branching=0.0, massless=0.0)
        for seed in (50, 51, 52):
            case = benchmark.make_case(urdf, seed, good=False)
            for name in names:
                pi = benchmark.METHODS[name](case)
                errors[name].append(benchmark.torque_error(case, pi))
                if name != "ridge to the URDF":
                    assert is_physical(pi.reshape(-1, 10)).all()
    mean = {name: float(np.exp(np.log(values).mean())) for name, values in errors.items()}
    assert mean["physical fit, kappa 3"] < 0.1 * mean["ridge to the URDF"]
    assert mean["physical fit, kappa 3"] < mean["OLS, projection in Gram metric"] < mean["ARD, projection by relevance"]
    assert max(errors["physical fit, kappa 3"]) < 0.1
