"""Everything that takes tensors takes them on a GPU, and says there what it says on the CPU."""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import fields, replace

import pytest
import torch
from effects.sites import SCALE, signals, site_of
from effects.sites import states as in_time
from model.arms import arm, states
from torch import Tensor, nn

from torchrbd import BaseRegression, BayesianDynamics, NaturalGradient, fit_residual, known_effects
from torchrbd.effects import Effect, Signals, Term
from torchrbd.learning import ResidualDataset, ResidualDynamics, physics_columns
from torchrbd.model import RigidBodyDynamics

pytestmark = pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device")

ARM = arm()
N = 300


def on_gpu(*x: Tensor, dtype: torch.dtype | None = None) -> tuple[Tensor, ...]:
    return tuple(v.detach().to("cuda", dtype) for v in x)


def assert_same(found: Tensor, expected: Tensor, tolerance: float = 1e-10) -> None:
    assert found.device.type == "cuda"
    difference = (found.detach().cpu().double() - expected.detach()).abs().max()
    assert float(difference) <= tolerance * max(float(expected.detach().abs().max()), 1.0)


METHODS: dict[str, Callable[[RigidBodyDynamics, Tensor, Tensor, Tensor], Tensor]] = {
    "inverse dynamics": lambda model, *x: model.robot.inverse_dynamics(*x),
    "regressor": lambda model, *x: model.robot.regressor(*x),
    "regressor, samples last": lambda model, *x: model.robot.regressor_batch_last(*(v.mT for v in x)),
    "mass matrix": lambda model, *x: model.robot.mass_matrix(x[0]),
    "forward dynamics": lambda model, *x: model.robot.forward_dynamics(*x),
    "torque slopes": lambda model, *x: model.robot.torque_slopes(*x),
    "origin slopes": lambda model, *x: model.robot.origin_slopes(*x),
    "known torque": lambda model, *x: model.robot.known_torque(x[0], x[2]),
    "rotations": lambda model, *x: model.robot.body_poses(x[0])[0],
    "jacobian": lambda model, *x: model.robot.jacobian(x[0], 1),
    "module": lambda model, *x: model(*x),
    "module, forward": lambda model, *x: model.forward_dynamics(*x),
    "module, step": lambda model, *x: model.step(*x, 1e-3)[1],
    "module, step of Runge and Kutta": lambda model, *x: model.step(*x, 1e-3, method="runge_kutta")[1],
}


@pytest.mark.parametrize("method", METHODS.values(), ids=METHODS)
@pytest.mark.parametrize(("dtype", "tolerance"), [(torch.float64, 1e-10), (torch.float32, 2e-4)])
@pytest.mark.parametrize("samples", [N, 200_000])
def test_a_robot(method: Callable[..., Tensor], dtype: torch.dtype, tolerance: float, samples: int) -> None:
    x = states(ARM.robot, samples)
    model = copy.deepcopy(ARM).to("cuda", dtype)
    assert_same(method(model, *on_gpu(*x, dtype=dtype)), method(ARM, *x), tolerance)


def test_derivatives() -> None:
    x = states(ARM.robot, N, grad=True)
    tau = ARM(*x)
    weight = torch.linspace(-1, 1, tau.numel(), dtype=tau.dtype).reshape(tau.shape)
    expected = torch.autograd.grad(tau, (*x, *ARM.parameters()), weight)
    model, there = copy.deepcopy(ARM).cuda(), [v.requires_grad_() for v in on_gpu(*x)]
    found = torch.autograd.grad(model(*there), (*there, *model.parameters()), *on_gpu(weight))
    for one, other in zip(found, expected, strict=True):
        assert_same(one, other)


# torch's inductor uses names of torch that are to go.
@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::FutureWarning")
def test_a_compiled_module() -> None:
    x = states(ARM.robot, N)
    model = torch.compile(copy.deepcopy(ARM).cuda(), fullgraph=True)
    assert_same(model(*on_gpu(*x)), ARM(*x))


def moved(signals: Signals) -> Signals:
    given = {one.name: getattr(signals, one.name) for one in fields(signals)}
    return replace(signals, **{name: x.cuda() for name, x in given.items() if isinstance(x, Tensor)})


@pytest.mark.parametrize("effect", known_effects().values(), ids=known_effects())
def test_an_effect(effect: Effect) -> None:
    """Its torque, in the middle of its shapes."""
    here = signals(*in_time(N))
    site, shapes = site_of(effect), effect.shapes(SCALE)
    shape = shapes[len(shapes) // 2]
    count = len(effect.features(here, site, shape))
    term = Term(effect, site, torch.linspace(0.5, 1.0, count, dtype=torch.float64), shape)
    assert_same(copy.deepcopy(term).cuda()(moved(here)), term(here))


def test_a_posterior_trains() -> None:
    x = states(ARM.robot, N)
    tau = ARM(*x).detach() + 0.05 * states(ARM.robot, N, seed=2)[1]
    here = BayesianDynamics(ARM)
    here.whiten(*x, tau)
    there = BayesianDynamics(ARM).cuda()
    there.whiten(*on_gpu(*x, tau))
    assert_same(there.elbo(*on_gpu(*x, tau)), here.elbo(*x, tau), 1e-8)
    there.elbo(*on_gpu(*x, tau)).backward()
    assert_same(there.predict(*on_gpu(*x)).mean, here.predict(*x).mean)
    robots = there.sample_robots(8)
    assert bool(robots(*on_gpu(*states(ARM.robot, 8))).isfinite().all())


def test_natural_gradients() -> None:
    x = states(ARM.robot, N)
    tau = 1.1 * ARM(*x).detach()
    after: list[nn.Module] = []
    for device in ("cpu", "cuda"):
        model = copy.deepcopy(ARM).to(device)
        inputs = [v.to(device) for v in (*x, tau)]
        weight = torch.ones(ARM.robot.n_dof, dtype=torch.float64, device=device)
        optimiser = NaturalGradient(model)
        (0.5 * weight * (model(*inputs[:3]) - inputs[3]).square()).sum(-1).mean().backward()
        optimiser.observe(*inputs[:3], weight)
        optimiser.step()
        after.append(model)
    for found, expected in zip(after[1].parameters(), after[0].parameters(), strict=True):
        assert_same(found, expected, 1e-8)


def test_a_network_on_top() -> None:
    moving, n = states(ARM.robot, 2000), ARM.robot.n_dof
    residual, count = torch.tanh(moving[0]), torch.arange(2000)
    data = ResidualDataset(
        physics=ARM, features=torch.cat(moving, -1), residual=residual, weight=torch.ones_like(residual),
        physics_torque=ARM(*moving).detach(), recordings=("made",), recording=0 * count, t=0.05 * count.double(),
        dt=0.05, cutoff_hz=5.0, history=0, noise_std=torch.ones(n), sample=count, columns=physics_columns(ARM, *moving),
    )  # fmt: skip
    model = ResidualDynamics(copy.deepcopy(ARM)).cuda()
    fit_residual(model, data, epochs=2, progress=False)
    x = data.features
    assert_same(model.network_torque(x.cuda()), copy.deepcopy(model).cpu().network_torque(x), 1e-4)


@pytest.mark.parametrize("square_root", [False, True])
def test_base_parameters(square_root: bool) -> None:
    """Samples may lie on a GPU; what is kept of them lies on the CPU."""
    x = states(ARM.robot, 2000)
    tau = ARM.robot.inverse_dynamics(*x)
    here, there = (BaseRegression(ARM.robot, square_root=square_root) for _ in range(2))
    here.take(*x, tau)
    there.take(*on_gpu(*x, tau))
    torch.testing.assert_close(there.solve().value, here.solve().value, rtol=1e-6, atol=1e-8)
