"""The nearest physical parameters: scipy's constrained minimum, idempotence, and what the metric is good for."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg
import scipy.optimize
import torch
from inference.problems import columns_of, prior_of, random_moments, urdf_of
from noisy_robots import FINAL, final_robots
from parameters.bodies import by_hand
from torch import Tensor

from torchrbd.dataset.block_statistics import assemble
from torchrbd.errors import InputError
from torchrbd.inference.physical import projection
from torchrbd.inference.physical.projection import project, relevance
from torchrbd.parameters import from_log_cholesky, to_log_cholesky
from torchrbd.regression.ard import ard
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
    """In any metric; so does what has been projected once."""
    robot, pi, pi_hat, gram = case(seed)
    prior = prior_of(columns_of(robot, ()))
    other = from_log_cholesky(to_log_cholesky(pi.reshape(-1, 10)) + 0.2).flatten()
    for metric in (gram, gram.diagonal(), torch.linalg.inv(prior.scale[:20, :20] @ prior.scale[:20, :20].T)):
        assert torch.equal(project(prior, other, metric), other)
        nearest = project(prior, pi_hat, metric)
        assert torch.equal(project(prior, nearest, metric), nearest)


def test_physical_estimates_on_the_boundary_are_moved_inside() -> None:
    """Bodies that are thin to a part in 1e6: by little, in the metric."""
    robot, pi, _, gram = case(1)
    gram = gram + torch.diag(gram.diagonal() + 1.0)
    theta = to_log_cholesky(pi.reshape(-1, 10))
    thin = from_log_cholesky(theta + torch.tensor([0.0, -14.0, -14.0, -14.0] + [0.0] * 6)).flatten()
    found = project(prior_of(columns_of(robot, ())), thin, gram)
    assert bounded(pi, found)
    assert not bounded(pi, thin)
    assert distance(found, thin, gram) < 1e-5 * distance(pi, thin, gram)


def relative(pi0: Tensor, pi: Tensor) -> np.ndarray:
    """Return the eigenvalues (n, 4) of J0^-1 J by scipy."""
    pairs = zip(pseudo_inertia(pi0.reshape(-1, 10)), pseudo_inertia(pi.reshape(-1, 10)), strict=True)
    return np.stack([scipy.linalg.eigh(J.numpy(), J0.numpy(), eigvals_only=True) for J0, J in pairs])


def bounded(pi0: Tensor, pi: Tensor) -> bool:
    g = relative(pi0, pi)
    return bool((g > 0).all()) and float((g + 1 / g - 2).sum()) <= 1e8


@pytest.mark.parametrize("size", [0.5, 5.0])
@pytest.mark.parametrize("samples", [8, 300])
def test_bounds_at_forty_bodies_some_without_mass(samples: int, size: float) -> None:
    """Metric with and without full rank. The cost is that of a barrier ten thousand times lower, and as promised."""
    robot = RobotModel.from_urdf(urdf_of(9, 40, massless=0.15, fixed=0.0))
    heavy = (robot.pi.reshape(-1, 10)[:, 0] > 0).repeat_interleave(10)
    assert 300 <= int(heavy.sum()) < len(heavy)
    rng = np.random.default_rng(9)
    noise = size * robot.pi.abs().reshape(-1, 10).amax(0).repeat(40) * torch.from_numpy(rng.normal(size=robot.n_params))
    pi_hat = robot.pi + torch.where(heavy, noise, 0.0)
    columns = columns_of(robot, ())
    H, _ = assemble(columns, random_moments(columns, 9, samples).total(), torch.ones(40, dtype=torch.float64))
    prior, metric = prior_of(columns), H[: robot.n_params, : robot.n_params]
    found = project(prior, pi_hat, metric)
    assert torch.equal(found[~heavy], robot.pi[~heavy])
    assert by_hand(found[heavy].reshape(-1, 10)).all()
    assert bounded(robot.pi[heavy], found[heavy])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(projection, "_EPSILON", 1e-12)
        nearest = project(prior, pi_hat, metric)
    cost = distance(found, pi_hat, metric) - distance(nearest, pi_hat, metric)
    n, whole = int(heavy.sum()) // 10, distance(robot.pi, pi_hat, metric)
    assert 0.0 < cost < 1e-8 * whole * (4 * n + relative(robot.pi[heavy], nearest[heavy]).sum())


@pytest.mark.slow
@pytest.mark.parametrize("name", list(FINAL))
def test_real_arms_stay_off_the_boundary_at_little_cost(name: str) -> None:
    """Least squares on few noisy samples: of each body's own second moment a millionth is left in every direction."""
    robot = RobotModel.from_urdf(final_robots()[name])
    prior, rng = prior_of(columns_of(robot, ())), np.random.default_rng(3)
    for _ in range(5):
        q, qd, qdd = (torch.from_numpy(rng.normal(size=(60, 7))) for _ in range(3))
        Y = robot.regressor(q, qd, qdd)
        truth = from_log_cholesky(
            to_log_cholesky(robot.pi.reshape(-1, 10)) + 0.2 * torch.from_numpy(rng.normal(size=(7, 10)))
        ).flatten()
        rms = (Y @ truth).square().mean(0).sqrt()
        A, b = (Y / rms[:, None]).flatten(0, 1), ((Y @ (truth - robot.pi)) / rms).flatten()
        b = b + 0.1 * torch.from_numpy(rng.normal(size=b.shape))
        pi_hat = robot.pi + torch.from_numpy(np.linalg.pinv(A.numpy(), rcond=1e-8)) @ b
        found = project(prior, pi_hat, A.T @ A)
        assert not by_hand(pi_hat.reshape(-1, 10)).all()
        J = pseudo_inertia(found.reshape(-1, 10))
        central = torch.linalg.eigvalsh(J[:, :3, :3] - J[:, :3, 3:] * J[:, 3:, :3] / J[:, 3:, 3:])
        share = float((central[:, 0] / central.sum(1)).min())
        error = {}
        for epsilon in (1e-8, 1e-12):
            with pytest.MonkeyPatch.context() as patch:
                patch.setattr(projection, "_EPSILON", epsilon)
                pi = project(prior, pi_hat, A.T @ A)
            error[epsilon] = float((A @ (pi - robot.pi) - b).square().mean())
        print(f"{name}: least share {share:.1e}, cost {error[1e-8] / error[1e-12] - 1:.1e}")
        assert share > 1e-6
        assert error[1e-8] < 1.01 * error[1e-12]


def test_scale_of_the_metric_does_not_matter() -> None:
    robot, _, pi_hat, metric = case(2)
    prior = prior_of(columns_of(robot, ()))
    scaled, same = project(prior, pi_hat, 1e6 * metric), project(prior, pi_hat, metric)
    assert distance(scaled, same, metric) < 1e-12 * distance(robot.pi, pi_hat, metric)
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


def test_terms_that_may_move_follow_and_others_stay() -> None:
    """At the minimum the metric's pull on the terms that may move vanishes: they make up for what the bodies lost."""
    robot, pi, pi_hat, _ = case(3, 3)
    columns = columns_of(robot, ("viscous_friction",))
    prior, n = prior_of(columns), robot.n_params
    H, _ = assemble(columns, random_moments(columns, 3, 300).total(), torch.ones(3, dtype=torch.float64))
    # Features correlate with the regressor, as in a recording.
    H = H + 0.1 * torch.outer(H.diagonal().sqrt(), H.diagonal().sqrt())
    x_hat = torch.cat((pi_hat, torch.full((columns.n - n,), 2.0, dtype=torch.float64)))
    terms = torch.arange(n, n + 2)
    found = project(prior, x_hat, H, terms)
    pull = H @ (found - x_hat)
    assert float(pull[terms].abs().max()) < 1e-6 * float((H @ (prior.mean - x_hat)).abs().max())
    others = torch.ones(columns.n, dtype=torch.bool).index_fill_(0, torch.cat((torch.arange(n), terms)), False)
    assert torch.equal(found[others], prior.mean[others])
    assert bounded(pi, found[:n])


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
