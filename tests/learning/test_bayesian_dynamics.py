"""The posterior as a module: against closed forms, the convex fit and an identification; samples, files, contact."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from model.arms import URDF, arm, states, term
from torch import Tensor

import torchrbd
from torchrbd.errors import InputError
from torchrbd.inference import Identification
from torchrbd.learning import BayesianDynamics
from torchrbd.model import RigidBodyDynamics
from torchrbd.parameters import is_physical

NOISE = 0.05


def samples(model: RigidBodyDynamics, n: int, seed: int = 1) -> tuple[Tensor, ...]:
    """Return states and torques with noise, (n, n_dof) each."""
    x = states(model.robot, n, seed=seed)
    tau = model(*x).detach()
    noise = torch.from_numpy(np.random.default_rng(seed).normal(size=tau.shape))
    return (*x, tau + NOISE * noise)


@pytest.fixture(scope="module")
def identified() -> Identification:
    demo = files("torchrbd") / "demo"
    return torchrbd.identify(str(demo / "arm.urdf"), str(demo / "fit.parquet"))


def test_coefficients_alone_have_the_closed_form() -> None:
    """Bodies known, noise given: the posterior of linear regression, by numpy."""
    model = arm()
    x = samples(model, 60)
    bayes = BayesianDynamics(model, term_std=0.4, noise_std=torch.full((3,), NOISE), trust=model.robot.body_names)
    bayes.raw_noise.requires_grad_(False)
    optimiser = torch.optim.LBFGS(
        [bayes.mean, bayes.raw_factor], max_iter=400, tolerance_grad=1e-12, tolerance_change=1e-14,
        line_search_fn="strong_wolfe",
    )  # fmt: skip

    def loss() -> float:
        optimiser.zero_grad()
        found = -bayes.elbo(*x)
        found.backward()
        return float(found.detach())

    optimiser.step(loss)
    phi = []
    start = torch.cat([t.coefficients.detach() for t in model.terms])
    for k in range(len(start)):
        with torch.no_grad():
            one = arm()
            for t in one.terms:
                t.coefficients.zero_()
            bare = one(*x[:3])
            torch.nn.utils.vector_to_parameters(
                torch.eye(len(start), dtype=start.dtype)[k], [t.coefficients for t in one.terms]
            )
            phi.append((one(*x[:3]) - bare).flatten().numpy())
    A = np.stack(phi, -1)
    residual = (x[3] - model(*x[:3]).detach()).flatten().numpy()
    covariance = np.linalg.inv(A.T @ A / NOISE**2 + np.eye(len(start)) / 0.4**2)
    mean = start.numpy() + covariance @ A.T @ residual / NOISE**2
    np.testing.assert_allclose(bayes.theta[-len(start) :].detach().numpy(), mean, rtol=0, atol=1e-6)
    np.testing.assert_allclose((bayes.root @ bayes.root.T).detach().numpy(), covariance, rtol=1e-4, atol=1e-9)


def test_trained_by_autograd_it_is_the_convex_fit() -> None:
    """From another robot, in log-Cholesky coordinates, against the interior-point fit in pi with the same prior."""
    truth = RigidBodyDynamics(arm().robot)
    x = samples(truth, 400)
    start = RigidBodyDynamics(arm().robot, 1.4 * truth.pi.detach())
    bayes = BayesianDynamics(start)
    bayes.fit(*x)
    inputs = torch.cat(x[:3], -1).numpy()
    regressor = torchrbd.DynamicsRegressor(torchrbd.to_urdf(start), friction=False).fit(inputs, x[3].numpy())
    found = bayes.predict(*x[:3])
    apart = (found.mean.detach().numpy() - regressor.predict(inputs)) / found.parameter_std.detach().numpy()
    assert np.sqrt((apart**2).mean(0)).max() < 0.05
    np.testing.assert_allclose(bayes.noise_std.detach().numpy(), regressor.noise_std_, rtol=0.03)
    right = (found.mean - truth(*x[:3])) / found.parameter_std
    assert 0.3 < float(right.detach().square().mean().sqrt()) < 2.0


def test_plain_gradients_learn_in_whitened_coordinates() -> None:
    """Adam on minibatches, with a second loss beside the bound."""
    truth = arm()
    x = samples(truth, 512)
    start = RigidBodyDynamics(truth.robot, 1.3 * truth.robot.pi, [term("viscous_friction", j, 0.0) for j in range(3)])
    bayes = BayesianDynamics(start)
    before = float((bayes(*x[:3]) - x[3]).detach().square().mean())
    bayes.whiten(*x)
    optimiser, order = torch.optim.Adam(bayes.parameters(), lr=0.02), torch.Generator().manual_seed(0)
    for _ in range(6):
        for batch in torch.randperm(512, generator=order).split(64):
            own = [v[batch] for v in x]
            loss = -bayes.elbo(*own, n_samples=512) / 512 + 1e-3 * bayes.mean.square().sum()
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
    after = float((bayes(*x[:3]) - x[3]).detach().square().mean())
    assert after < 0.2 * before
    assert is_physical(bayes.robot().pi.detach().reshape(-1, 10)).all()


def test_terms_alone_are_fitted_where_bodies_are_known() -> None:
    """Least squares has the same coefficients, where data are many."""
    truth = arm()
    x = samples(truth, 2000)
    start = RigidBodyDynamics(truth.robot, terms=[term("viscous_friction", j, 0.0) for j in range(3)])
    bayes = BayesianDynamics(start, trust=truth.robot.body_names)
    bayes.fit(*x)
    residual = x[3] - truth.robot.inverse_dynamics(*x[:3])
    expected = (residual * x[1]).sum(0) / x[1].square().sum(0)
    torch.testing.assert_close(bayes.theta[-3:].detach(), expected, rtol=1e-3, atol=1e-3)
    assert torch.equal(bayes.robot().pi, start.pi)


def test_minibatches_stand_for_all_samples() -> None:
    bayes = BayesianDynamics(arm())
    x = samples(arm(), 60)
    parts = [bayes.elbo(*(v[k : k + 20] for v in x), n_samples=60) for k in (0, 20, 40)]
    torch.testing.assert_close(sum(parts) / 3, bayes.elbo(*x))


def test_gradients_of_the_bound() -> None:
    """In some directions, as finite differences have them."""
    torch.manual_seed(0)
    bayes = BayesianDynamics(arm())
    x = samples(arm(), 4)
    with torch.no_grad():
        for p in bayes.parameters():
            p.add_(0.01 * torch.randn_like(p))
    bayes.elbo(*x).backward()
    for p in (bayes.mean, bayes.raw_factor, bayes.raw_noise):
        direction = torch.randn_like(p)
        ends = []
        with torch.no_grad():
            for step in (1e-6, -2e-6):
                p.add_(step * direction)
                ends.append(float(bayes.elbo(*x)))
            p.add_(1e-6 * direction)
        assert p.grad is not None
        assert float((p.grad * direction).sum()) == pytest.approx((ends[0] - ends[1]) / 2e-6, rel=1e-5)


def test_the_posterior_of_an_identification(identified: Identification, tmp_path: Path) -> None:
    """Mean and variances are those that the identification has; a file holds them, and a plain model."""
    bayes = BayesianDynamics.from_diagnosis(identified)
    x = states(identified.robot, 30)
    found, posterior = bayes.predict(*x), identified.posterior
    assert posterior is not None
    known = posterior.torque_variance(*x)
    torch.testing.assert_close(found.mean, identified.model(*x))
    torch.testing.assert_close(found.parameter_std.square(), known.parameters, rtol=1e-6, atol=1e-12)
    torch.testing.assert_close(found.noise_std.square(), known.noise)
    bayes.save(tmp_path / "model.safetensors")
    again = BayesianDynamics.from_diagnosis(tmp_path).predict(*x)
    for one, other in zip(again, found, strict=True):
        torch.testing.assert_close(one, other, rtol=1e-12, atol=1e-12)
    torch.testing.assert_close(RigidBodyDynamics.load(tmp_path)(*x), found.mean)


def test_robots_drawn_are_physical_and_as_far_apart_as_believed(identified: Identification) -> None:
    bayes = BayesianDynamics.from_diagnosis(identified)
    robots = bayes.sample_robots(200, seed=1)
    q, qd, qdd = (v.expand(200, -1, -1) for v in states(identified.robot, 20))
    with torch.no_grad():
        tau, found = robots(q, qd, qdd), bayes.predict(q[0], qd[0], qdd[0])
    ratio = tau.std(0) / found.parameter_std
    assert 0.8 < float(ratio.median()) < 1.2
    assert is_physical(torch.stack([robots[k].pi.detach().reshape(-1, 10) for k in (0, 77, 199)])).all()
    torch.testing.assert_close(tau[77], robots[77](q[77], qd[77], qdd[77]).detach(), rtol=1e-10, atol=1e-10)
    moved = robots.step(q[:, 0], qd[:, 0], tau[:, 0], 1e-3)
    alone = robots[77].step(q[77, 0], qd[77, 0], tau[77, 0], 1e-3)
    for one, other in zip(moved, alone, strict=True):
        torch.testing.assert_close(one[77], other, rtol=1e-6, atol=1e-9)
    assert torch.equal(robots(q, qd, qdd), bayes.sample_robots(200, seed=1)(q, qd, qdd))
    with pytest.raises(InputError, match="is 0, expected at least 1"):
        bayes.sample_robots(0)


def test_contact_is_out_of_the_band() -> None:
    """At the joint that is touched; elsewhere as seldom as was asked."""
    model = arm()
    x = samples(model, 4000)
    bayes = BayesianDynamics(model, noise_std=torch.full((3,), NOISE))
    bayes.whiten(*x)
    touched = x[3].clone()
    touched[1000:2000, 1] += 6.0 * NOISE
    found = bayes.tau_ext(*x[:3], touched, probability=0.99)
    assert float(found.touched[1000:2000, 1].double().mean()) > 0.99
    assert 0.005 < float(found.touched[2000:].double().mean()) < 0.02
    assert float(found.torque[1000:2000, 1].mean().detach()) == pytest.approx(6.0 * NOISE, rel=0.05)


def test_what_cannot_be_is_told(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="trust: 'elbow' is no body of robot 'random9'"):
        BayesianDynamics(arm(), trust=["elbow"])
    with pytest.raises(InputError, match="no posterior: its estimator gives no intervals"):
        BayesianDynamics.from_diagnosis(SimpleNamespace(model=arm(), posterior=None))
    RigidBodyDynamics.from_urdf(URDF).save(tmp_path / "model.safetensors")
    with pytest.raises(InputError, match="holds a model without a posterior"):
        BayesianDynamics.load(tmp_path)


def test_torques_that_the_model_makes_exactly() -> None:
    """Noise of nothing has no logarithm."""
    model = arm()
    x = states(model.robot, 200)
    bayes = BayesianDynamics(model)
    bayes.whiten(*x, model(*x).detach())
    assert bool(bayes.elbo(*x, model(*x).detach()).isfinite())
