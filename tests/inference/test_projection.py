"""The nearest physical parameters: scipy's constrained minimum, idempotence, and what the metric is good for."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.optimize
import torch
from inference.problems import columns_of, prior_of, random_moments, urdf_of
from parameters.bodies import by_hand
from torch import Tensor

from torchrbd.errors import InputError
from torchrbd.inference.data.block_statistics import assemble
from torchrbd.inference.physical.projection import project, relevance
from torchrbd.inference.regression.ard import ard
from torchrbd.parameters import from_log_cholesky, to_log_cholesky
from torchrbd.robot import RobotModel, pseudo_inertia


def case(seed: int, n_joints: int = 2, size: float = 0.5) -> tuple[RobotModel, Tensor, Tensor, Tensor]:
    """Return a robot, its parameters, an impossible estimate of them, and a metric: that of 30 random samples."""
    robot = RobotModel.from_urdf(urdf_of(seed, n_joints, fixed=0.0))
    rng = np.random.default_rng(seed)
    pi_hat = robot.pi + size * robot.pi.abs().reshape(-1, 10).amax(0).repeat(n_joints) * torch.from_numpy(
        rng.normal(size=robot.n_params)
    )
    columns = columns_of(robot, ())
    H, _ = assemble(columns, random_moments(columns, seed, 30).total(), torch.ones(n_joints, dtype=torch.float64))
    return robot, robot.pi, pi_hat, H[: robot.n_params, : robot.n_params]


def distance(pi: Tensor, pi_hat: Tensor, metric: Tensor) -> float:
    return float((pi - pi_hat) @ metric @ (pi - pi_hat))


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("kind", ["gram", "diagonal"])
def test_distance_is_scipys(seed: int, kind: str) -> None:
    """L-BFGS in log-Cholesky coordinates, where the problem is not convex: ours may be nearer, but not farther."""
    robot, start, pi_hat, metric = case(seed)
    if kind == "diagonal":
        metric = torch.diag(metric.diagonal() + 0.1)
    found = project(prior_of(columns_of(robot, ())), pi_hat, metric)
    assert not by_hand(pi_hat.reshape(-1, 10)).all()
    assert by_hand(found.reshape(-1, 10)).all()

    def value(theta: np.ndarray) -> tuple[float, np.ndarray]:
        t = torch.from_numpy(theta).requires_grad_()
        pi = from_log_cholesky(t.reshape(-1, 10)).flatten()
        f = (pi - pi_hat) @ metric @ (pi - pi_hat) / size
        return float(f.detach()), torch.autograd.grad(f, t)[0].numpy()

    size = distance(start, pi_hat, metric)
    theta = to_log_cholesky(start.reshape(-1, 10)).flatten().numpy()
    options = {"maxiter": 20_000, "maxfun": 40_000, "ftol": 1e-14, "gtol": 1e-10}
    best = scipy.optimize.minimize(value, theta, jac=True, method="L-BFGS-B", options=options)
    reached = distance(found, pi_hat, metric) / size
    assert reached < best.fun * (1 + 1e-6) + 1e-7
    assert reached > best.fun * 0.9 - 1e-7


@pytest.mark.parametrize("seed", range(3))
def test_first_order_conditions(seed: int) -> None:
    """At the nearest point of a convex cone the gradient, as a matrix on J, is semidefinite and orthogonal to J."""
    robot, _, pi_hat, metric = case(seed)
    metric = metric + 1e-3 * torch.diag(metric.diagonal().clamp_min(1e-3))
    found = project(prior_of(columns_of(robot, ())), pi_hat, metric)
    slope = (metric @ (found - pi_hat)).reshape(-1, 10)
    size = float((metric @ (robot.pi - pi_hat)).norm())
    # Along any physical body the distance grows, and along the solution itself it stands still.
    generator = torch.Generator().manual_seed(seed)
    theta = torch.randn(500, slope.shape[0], 10, generator=generator, dtype=torch.float64)
    bodies = from_log_cholesky(theta)
    growth = (bodies * slope).sum(-1) / bodies.norm(dim=-1)
    assert float(growth.min()) > -1e-5 * size
    along = (found.reshape(-1, 10) * slope).sum(-1)
    assert float(along.abs().max()) < 1e-5 * size * float(found.norm())


@pytest.mark.parametrize("seed", range(3))
def test_physical_estimates_stay(seed: int) -> None:
    robot, pi, pi_hat, gram = case(seed)
    other = from_log_cholesky(to_log_cholesky(pi.reshape(-1, 10)) + 0.2).flatten()
    prior = prior_of(columns_of(robot, ()))
    even = torch.linalg.inv(prior.scale[:20, :20] @ prior.scale[:20, :20].T)
    torch.testing.assert_close(project(prior, other, even), other, rtol=1e-6, atol=1e-8)
    nearest = project(prior, pi_hat, even)
    again = project(prior, nearest, even)
    assert distance(again, nearest, even) < 1e-6 * distance(nearest, pi_hat, even)
    assert distance(project(prior, other, gram), other, gram) < 1e-8 * distance(pi, other, gram)


def test_scale_of_the_metric_does_not_matter() -> None:
    robot, _, pi_hat, metric = case(2)
    prior = prior_of(columns_of(robot, ()))
    scaled, same = project(prior, pi_hat, 1e6 * metric), project(prior, pi_hat, metric)
    assert distance(scaled, same, metric) < 1e-10 * distance(robot.pi, pi_hat, metric)
    weights = metric.diagonal()
    torch.testing.assert_close(project(prior, pi_hat, weights), project(prior, pi_hat, torch.diag(weights)))


def test_what_has_no_weight_stays_at_the_prior() -> None:
    robot, pi, pi_hat, metric = case(3, 3)
    weights = metric.diagonal().clone()
    weights[10:] = 0.0
    found = project(prior_of(columns_of(robot, ())), pi_hat, weights)
    torch.testing.assert_close(found[10:], pi[10:], rtol=1e-6, atol=1e-8)
    silent = project(prior_of(columns_of(robot, ())), pi_hat, torch.zeros_like(weights))
    torch.testing.assert_close(silent, pi, rtol=1e-9, atol=1e-12)


def test_held_bodies_stay() -> None:
    robot, pi, pi_hat, metric = case(0, 3)
    prior = prior_of(columns_of(robot, ()), held=(robot.body_names[1],))
    assert torch.equal(project(prior, pi_hat, metric)[10:20], pi[10:20])


@pytest.mark.parametrize("seed", range(4, 8))
def test_gram_metric_predicts_torque_better_than_relevance(seed: int) -> None:
    """Torque of noisy samples fitted without constraint by ARD, then made physical in both metrics."""
    robot = RobotModel.from_urdf(urdf_of(seed, 4, fixed=0.0))
    rng = np.random.default_rng(seed)
    q, qd, qdd = (torch.from_numpy(rng.normal(size=(60, 4))) for _ in range(3))
    truth = from_log_cholesky(
        to_log_cholesky(robot.pi.reshape(-1, 10)) + 0.2 * torch.from_numpy(rng.normal(size=(4, 10)))
    ).flatten()
    Y = robot.regressor(q, qd, qdd).reshape(-1, robot.n_params)
    left = Y @ (truth - robot.pi)
    left = left + 0.3 * left.square().mean().sqrt() * torch.from_numpy(rng.normal(size=left.shape))
    n = len(left)
    G = Y.T @ Y / n
    found = ard(G, Y.T @ left / n, float(left.square().mean()), n)
    variance = found.covariance.diagonal()
    weights = relevance(torch.where(variance > 0, 1.0 / found.mean.square().clamp_min(1e-30), torch.inf), variance)
    prior = prior_of(columns_of(robot, ()))
    estimate = robot.pi + found.mean
    error = {
        name: float((Y @ (project(prior, estimate, M) - truth)).square().mean())
        for name, M in (("gram", G), ("relevance", weights))
    }
    assert error["gram"] < error["relevance"]


def test_relevance_is_the_datas_part_of_the_precision() -> None:
    alpha = torch.tensor([1.0, 4.0, torch.inf, 2.0], dtype=torch.float64)
    data = torch.tensor([3.0, 0.0, 5.0, 100.0], dtype=torch.float64)
    variance = torch.where(torch.isinf(alpha), 0.0, 1.0 / (alpha + data))
    torch.testing.assert_close(
        relevance(alpha, variance), torch.tensor([3.0, 0.0, 0.0, 100.0], dtype=torch.float64), rtol=0, atol=1e-9
    )


def test_bad_input() -> None:
    robot, _, pi_hat, metric = case(0)
    prior = prior_of(columns_of(robot, ()))
    with pytest.raises(InputError, match=r"metric has shape \(19, 20\), expected \(20, 20\)"):
        project(prior, pi_hat, metric[1:])
    with pytest.raises(InputError, match="not finite"):
        project(prior, torch.full_like(pi_hat, torch.nan), metric)


def test_result_is_inside() -> None:
    robot, _, pi_hat, metric = case(5, 3)
    found = project(prior_of(columns_of(robot, ())), pi_hat, metric)
    assert (torch.linalg.eigvalsh(pseudo_inertia(found.reshape(-1, 10))) > 0).all()
