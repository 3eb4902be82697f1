"""Robots drawn from the posterior: the Wishart distribution, a Metropolis chain of its own, and Gaussian marginals."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg
import scipy.stats
import torch
from inference.problems import EFFECTS, columns_of, prior_of, random_moments, urdf_of
from shortened import slow_but
from torch import Tensor

from torchrbd.dataset.block_statistics import BlockStatistics, assemble
from torchrbd.dataset.columns import Columns
from torchrbd.errors import InputError
from torchrbd.inference.physical.fitting import FittedModel, fit_model, term_candidates
from torchrbd.inference.posterior.predictive import predictive_variance
from torchrbd.inference.posterior.sampling import sample_robots
from torchrbd.likelihood.urdf_prior import Prior
from torchrbd.parameters import base_parameters
from torchrbd.robot import RobotModel, pseudo_inertia


def fitted(
    seed: int, n_joints: int, weight: float, *, kappa: float = 3.0, effects: tuple[str, ...] = (), samples: int = 40
) -> tuple[Columns, Prior, BlockStatistics, FittedModel]:
    """Fit random moments of the URDF's torque, all joints with the same weight; without terms but for ``effects``."""
    columns = columns_of(RobotModel.from_urdf(urdf_of(seed, n_joints, fixed=0.0)), effects)
    prior, statistics = prior_of(columns, kappa), random_moments(columns, seed, samples, columns.reference())
    noise = torch.full((n_joints,), 1.0 / weight if weight else torch.inf, dtype=torch.float64)
    return columns, prior, statistics, fit_model(statistics, prior, term_candidates(columns, effects), noise)


def bodies(x: Tensor, prior: Prior) -> Tensor:
    return pseudo_inertia(x[:, prior.inertial].unflatten(1, (-1, 10)))


@pytest.mark.parametrize("kappa", slow_but((10.0,), (2.0, 3.0, 10.0)))
def test_without_data_bodies_follow_the_wishart_distribution(kappa: float) -> None:
    """Of three seeds together, by Bonferroni's bound on all comparisons: what one seed hides is seen."""
    _, prior, _, model = fitted(3, 3, 0.0, kappa=kappa)
    J = torch.cat([bodies(sample_robots(prior, model, 2000, seed=seed).x, prior) for seed in range(3)]).numpy()
    p_values = [p for k in range(3) for p in wishart_p_values(J[:, k], prior, k, kappa)]
    assert len(p_values) * min(p_values) > 1e-3


def wishart_p_values(J: np.ndarray, prior: Prior, body: int, kappa: float) -> list[float]:
    """Compare draws (N, 4, 4) with the Wishart distribution: diagonal entries in units of the scale, determinants."""
    V = torch.linalg.inv(prior.inverse_inertia[body]).numpy() / (2 * kappa)
    root = np.linalg.cholesky(V)
    G = np.stack([scipy.linalg.solve_triangular(root, M, lower=True) for M in J])
    G = np.stack([scipy.linalg.solve_triangular(root, M.T, lower=True) for M in G])
    # In units of the scale matrix diagonal entries are chi-square, and the determinant is a product of them.
    found = [scipy.stats.kstest(G[:, i, i], scipy.stats.chi2(2 * kappa + 5).cdf).pvalue for i in range(4)]
    theirs = np.linalg.slogdet(scipy.stats.wishart(2 * kappa + 5, V).rvs(4000, random_state=body))[1]
    return [*found, scipy.stats.ks_2samp(np.linalg.slogdet(J)[1], theirs).pvalue]


def metropolis(log_density, start: np.ndarray, root: np.ndarray, n_steps: int, seed: int) -> np.ndarray:
    """Walk at random, 200 chains side by side."""
    rng = np.random.default_rng(seed)
    x = np.repeat(start[None], 200, 0)
    value, kept = log_density(x), []
    for step in range(n_steps):
        proposal = x + 0.6 / len(root) ** 0.5 * rng.normal(size=x.shape) @ root.T
        new = log_density(proposal)
        accepted = np.log(rng.random(len(x))) < new - value
        x, value = np.where(accepted[:, None], proposal, x), np.where(accepted, new, value)
        if step > n_steps // 4 and step % 20 == 0:
            kept.append(x.copy())
    return np.concatenate(kept)


@pytest.mark.slow
@pytest.mark.parametrize(("weight", "kappa"), [(0.03, 3.0), (1.0, 1.0)])
def test_moments_are_those_of_a_random_walk(weight: float, kappa: float) -> None:
    """The density as its equation has it: moments of the data, and the divergence by numpy."""
    columns, prior, statistics, model = fitted(1, 1, weight, kappa=kappa)
    H, h = (v.numpy() for v in assemble(columns, statistics.total(), torch.full((1,), weight, dtype=torch.float64)))
    H, h, inverse = H[:10, :10], h[:10], prior.inverse_inertia[0].numpy()

    def log_density(x: np.ndarray) -> np.ndarray:
        J = pseudo_inertia(torch.from_numpy(x)).numpy()
        inside = np.linalg.eigvalsh(J)[:, 0] > 0
        logdet = np.linalg.slogdet(np.where(inside[:, None, None], J, np.eye(4)))[1]
        value = x @ h - 0.5 * np.einsum("ni,ij,nj->n", x, H, x)
        value = value + kappa * (logdet - np.einsum("ij,nij->n", inverse, J))
        return np.where(inside, value, -np.inf)

    root = np.linalg.cholesky(model.laplace[:10, :10].numpy())
    theirs = metropolis(log_density, model.x[:10].numpy(), root, 8000, 0)
    ours = sample_robots(prior, model, 8000, widened=False).x[:, :10].numpy()
    std = theirs.std(0)
    assert (np.abs(ours.mean(0) - theirs.mean(0)) < 0.08 * std).all()
    assert (np.abs(np.log(ours.std(0) / std)) < 0.08).all()


def test_what_the_data_tells_is_gaussian() -> None:
    """The base parameters of a robot moved well: mean the fit, covariance that of the curvature."""
    columns, prior, _, model = fitted(2, 3, 1e5, samples=400)
    K = base_parameters(columns.robot).combination
    C = K @ model.laplace[:30, :30] @ K.T
    beta = (sample_robots(prior, model, 4000).x[:, :30] - model.x[:30]) @ K.T
    ratio = beta.std(0) / C.diagonal().sqrt()
    assert float((beta.mean(0) / C.diagonal().sqrt()).abs().max()) < 0.3
    assert float(ratio.min()) > 0.9
    assert float(ratio.max()) < 1.15


@pytest.mark.parametrize(("weight", "n_joints"), slow_but([(0.0, 2), (1e-2, 6)], [(0.0, 2), (1e-2, 6), (1e6, 6)]))
def test_every_sample_is_physical(weight: float, n_joints: int) -> None:
    _, prior, _, model = fitted(4, n_joints, weight)
    found = sample_robots(prior, model, 100, seed=5)
    assert found.x.shape == (100, len(model.x))
    assert (torch.linalg.eigvalsh(bodies(found.x, prior)) > 0).all()
    assert torch.equal(found.x, sample_robots(prior, model, 100, seed=5).x)
    assert not torch.equal(found.x, sample_robots(prior, model, 100, seed=6).x)
    assert found.autocorrelation < 10
    assert found.thinning >= found.autocorrelation


def test_widened_covariance_widens_what_the_data_tells_only() -> None:
    _, prior, _, model = fitted(5, 2, 1e3, samples=100)
    values, axes = torch.linalg.eigh(model.laplace)
    wide = model.laplace + 8.0 * (axes[:, :4] * values[:4]) @ axes[:, :4].T
    widened = FittedModel(**{**vars(model), "covariance": wide})
    ours = sample_robots(prior, widened, 2000).x[:, model.free] @ axes
    theirs = sample_robots(prior, widened, 2000, widened=False).x[:, model.free] @ axes
    ratio = ours.std(0) / theirs.std(0)
    assert (ratio[:4] > 2.5).all()
    assert (ratio[:4] < 3.5).all()
    assert abs(float(ratio[-1]) - 1.0) < 0.1


def test_terms_are_drawn_and_held_bodies_are_not() -> None:
    columns, _, statistics, _ = fitted(6, 3, 1.0, effects=EFFECTS)
    prior = prior_of(columns, held=(columns.robot.body_names[0],))
    model = fit_model(statistics, prior, term_candidates(columns, EFFECTS), torch.ones(3, dtype=torch.float64))
    x = sample_robots(prior, model, 2000, widened=False).x
    assert torch.equal(x[:, :10], columns.robot.pi[:10].expand(2000, 10))
    terms = torch.arange(len(prior.inertial), len(model.free))
    expected = model.laplace.diagonal()[terms].sqrt()
    torch.testing.assert_close(x[:, model.free[terms]].std(0), expected, rtol=0.15, atol=1e-12)


def test_at_least_one_sample() -> None:
    _, prior, _, model = fitted(0, 1, 1.0)
    assert sample_robots(prior, model, 1).x.shape[0] == 1
    with pytest.raises(InputError, match="n_samples is 0, expected at least 1"):
        sample_robots(prior, model, 0)


def test_predictive_variance_is_that_of_drawn_coefficients() -> None:
    columns, _, statistics, _ = fitted(7, 4, 1.0, effects=EFFECTS)
    prior = prior_of(columns)
    model = fit_model(statistics, prior, term_candidates(columns, EFFECTS), torch.ones(4, dtype=torch.float64))
    rng = np.random.default_rng(0)
    q, qd, qdd = (torch.from_numpy(rng.normal(size=(2, 3, 4))) for _ in range(3))
    found = predictive_variance(model, q, qd, qdd)
    assert found.parameters.shape == (2, 3, 4)
    assert torch.equal(found.noise, model.noise_variance)
    values, axes = np.linalg.eigh(model.covariance.numpy())
    draws = rng.normal(size=(40_000, len(values))) * np.sqrt(values.clip(0)) @ axes.T
    x = model.x.repeat(40_000, 1)
    x[:, model.free] += torch.from_numpy(draws)
    for i in range(2):
        for k in range(3):
            at = q[i, k], qd[i, k], qdd[i, k]
            Y = columns.robot.regressor(*at)
            torque = x[:, : columns.robot.n_params] @ Y.T
            for j in range(4):
                width = columns.scales[j].rest_width
                phi = {"qd": at[1][j], "sign(qd)": torch.tanh(at[1][j] / width), "qdd": at[2][j], "q": at[0][j]}
                for label in columns.labels[j]:
                    torque[:, j] += x[:, columns.index(j, label)] * phi.get(label, torch.tensor(1.0))
            torch.testing.assert_close(torque.var(0), found.parameters[i, k], rtol=0.04, atol=0)
            looped = predictive_variance(model, *(v.unsqueeze(0) for v in at))
            torch.testing.assert_close(looped.parameters[0], found.parameters[i, k], rtol=1e-10, atol=0)


def test_predictive_variance_in_pieces_is_that_of_the_whole() -> None:
    _, _, _, model = fitted(8, 3, 1.0)
    states = [torch.from_numpy(np.random.default_rng(k).normal(size=(5000, 3))) for k in range(3)]
    whole = predictive_variance(model, *states).parameters
    part = predictive_variance(model, *(v[2000:2100] for v in states)).parameters
    torch.testing.assert_close(part, whole[2000:2100], rtol=1e-10, atol=0)
    assert predictive_variance(model, *(v[:0] for v in states)).parameters.shape == (0, 3)


def test_samples_agree_with_the_predictive_variance_where_the_data_tells() -> None:
    columns, prior, _, model = fitted(2, 3, 1e4, samples=400)
    x = sample_robots(prior, model, 4000).x[:, :30]
    states = [torch.from_numpy(np.random.default_rng(k).normal(size=(5, 3))) for k in range(3)]
    torque = torch.einsum("njp,kp->knj", columns.robot.regressor(*states), x)
    torch.testing.assert_close(torque.var(0), predictive_variance(model, *states).parameters, rtol=0.2, atol=0)
