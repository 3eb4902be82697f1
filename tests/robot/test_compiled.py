"""The compiled kernels against torch's own operations: values, derivatives, layouts, and what a call may be part of."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable

import pytest
import torch
from robot.random_robots import random_states, random_urdf
from torch import Tensor
from torch.autograd import forward_ad, gradgradcheck

from torchrbd.parameters import from_log_cholesky
from torchrbd.robot import RobotModel, compiled, eager
from torchrbd.robot.compiled.operators import OPERATORS

pytestmark = pytest.mark.skipif(not compiled.is_available(), reason="no C compiler")

MIXED = random_urdf(9, 4, mimic=0.3)
"""Four bodies, revolute and prismatic, branches, one mimic joint."""
TOLERANCE = 1e-12

# torch's forward mode compiles its own rules so.
SCRIPTED = pytest.mark.filterwarnings("ignore:.torch.jit.script. is deprecated")


@pytest.fixture(scope="module")
def robot() -> RobotModel:
    return RobotModel.from_urdf(MIXED)


@pytest.fixture
def no_eager(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let torch's own operations fail."""

    def refuse(*_: object) -> Tensor:
        raise AssertionError("not computed by a kernel")

    for name in ("inverse_dynamics", "regressor", "regressor_batch_last", "mass_matrix", "torque_slopes"):
        monkeypatch.setattr(eager, name, refuse)


def states(robot: RobotModel, *batch: int, seed: int = 1, grad: bool = False) -> tuple[Tensor, ...]:
    return tuple(torch.from_numpy(x).requires_grad_(grad) for x in random_states(seed, *batch, robot.n_dof))


def constants(robot: RobotModel, grad: bool = True) -> tuple[Tensor, Tensor]:
    pi = torch.randn(robot.n_params, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    return pi.requires_grad_(grad), torch.tensor([1.0, 2.0, -9.0], dtype=torch.float64, requires_grad=grad)


def close(found: Tensor, expected: Tensor, tolerance: float = TOLERANCE) -> None:
    assert found.shape == expected.shape
    assert found.dtype == expected.dtype
    found, expected = found.detach(), expected.detach()
    if expected.numel():
        assert (found - expected).abs().max() <= tolerance * max(1.0, float(expected.abs().max()))


def functions(robot: RobotModel) -> dict[str, Callable[..., Tensor]]:
    """Return methods, all of (q, qd, qdd, pi, gravity)."""
    return {
        "inverse_dynamics": robot.inverse_dynamics,
        "regressor": lambda q, qd, qdd, pi, gravity: robot.regressor(q, qd, qdd, gravity),
        "mass_matrix": lambda q, qd, qdd, pi, gravity: robot.mass_matrix(q, pi),
    }


def value_and_derivatives(function: Callable[..., Tensor], arguments: tuple[Tensor, ...]) -> list[Tensor]:
    value = function(*arguments)
    weight = torch.rand(value.shape, dtype=value.dtype, generator=torch.Generator().manual_seed(1))
    slopes = torch.autograd.grad(value, arguments, weight, allow_unused=True)
    return [value.detach(), *(x for x in slopes if x is not None)]


@pytest.mark.parametrize("seed", range(24))
def test_equal_to_torch(seed: int) -> None:
    """Values and derivatives, for batches that fill no lanes, some, all and more."""
    robot = RobotModel.from_urdf(random_urdf(seed, 1 + seed % 12, mimic=0.3 * (seed % 2)))
    x = (*states(robot, (1, 7, 8, 37)[seed % 4], seed=seed, grad=True), *constants(robot))
    for function in functions(robot).values():
        found = value_and_derivatives(function, x)
        with compiled.only_eager():
            expected = value_and_derivatives(function, x)
        for a, b in zip(found, expected, strict=True):
            close(a, b)
    with torch.no_grad():
        slopes = robot.torque_slopes(*x[:4])
        with compiled.only_eager():
            close(slopes, robot.torque_slopes(*x[:4]))


@pytest.mark.parametrize("shape", [(), (0,), (2, 3), (70,)])
@pytest.mark.usefixtures("no_eager")
def test_shapes_and_layouts(robot: RobotModel, shape: tuple[int, ...]) -> None:
    """Samples first, samples last, strided, expanded: as contiguous copies."""
    q, qd, qdd = states(robot, *shape)
    pi, gravity = constants(robot, grad=False)
    wide = torch.stack((q, qd), -1)
    twins = [(wide[..., 0], qd, qdd)]
    if len(shape) == 1:
        twins.append(tuple(x.T.contiguous().T for x in (q, qd, qdd)))
    for function in functions(robot).values():
        expected = function(q, qd, qdd, pi, gravity)
        assert expected.shape[: len(shape)] == shape
        for twin in twins:
            assert torch.equal(function(*twin, pi, gravity), expected)
        one = function(q, qd[..., :1, :] if qd.ndim > 1 else qd, qdd, pi, gravity)
        assert one.shape == expected.shape
    assert robot.torque_slopes(q, qd, qdd).shape == (*shape, 3, robot.n_dof, robot.n_dof)


def test_batch_last(robot: RobotModel) -> None:
    q, qd, qdd = states(robot, 21)
    Y = robot.regressor_batch_last(q.T.contiguous(), qd.T.contiguous(), qdd.T.contiguous())
    assert Y.is_contiguous()
    assert torch.equal(Y.movedim(-1, 0), robot.regressor(q, qd, qdd))


def test_a_derivative_of_samples_last(robot: RobotModel) -> None:
    q, qd, qdd = (x.T.contiguous().T.requires_grad_() for x in states(robot, 21))
    weight = torch.rand(21, robot.n_dof, dtype=q.dtype)
    found = torch.autograd.grad(robot.inverse_dynamics(q, qd, qdd), (q, qd, qdd), weight)
    with compiled.only_eager():
        expected = torch.autograd.grad(robot.inverse_dynamics(q, qd, qdd), (q, qd, qdd), weight)
    for a, b in zip(found, expected, strict=True):
        close(a, b)


def test_derivatives_that_are_asked_for(robot: RobotModel) -> None:
    """One argument at a time, an empty batch, and none under no_grad or in inference mode."""
    q, qd, qdd = states(robot, 5)
    for k in range(5):
        x = [v.detach() for v in (q, qd, qdd, *constants(robot, grad=False))]
        x[k].requires_grad_()
        robot.inverse_dynamics(*x).sum().backward()
        assert [v.grad is not None for v in x] == [k == j for j in range(5)]
        with torch.no_grad():
            assert not robot.inverse_dynamics(*x).requires_grad
        with torch.inference_mode():
            assert robot.inverse_dynamics(*x).is_inference()
    pi, gravity = constants(robot)
    robot.inverse_dynamics(q[:0], qd[:0], qdd[:0], pi, gravity).sum().backward()
    assert pi.grad is not None
    assert gravity.grad is not None
    assert pi.grad.eq(0).all()
    assert gravity.grad.eq(0).all()


def test_a_sample_that_is_not_a_number_stays_alone(robot: RobotModel) -> None:
    q, qd, qdd = states(robot, 20)
    q[3, 0] = torch.nan
    tau = robot.inverse_dynamics(q, qd, qdd)
    assert tau[3].isnan().any()
    assert torch.cat((tau[:3], tau[4:])).isfinite().all()


def test_angles_of_any_size() -> None:
    """Torque by sine and cosine: a revolute joint under gravity, close to zeros and beyond what lanes can reduce."""
    robot = RobotModel.from_urdf(random_urdf(2, 1, kinds=("revolute",), fixed=0))
    near = torch.arange(-50, 51, dtype=torch.float64)[:, None] * torch.pi / 4
    q = torch.cat((near, near + 1e-9, near * 1e3, near * 1e5, near * 1e9))
    still = torch.zeros_like(q)
    found = robot.inverse_dynamics(q, still, still)
    with compiled.only_eager():
        close(found, robot.inverse_dynamics(q, still, still), 1e-14)


def test_second_derivatives_of_the_regressor(robot: RobotModel) -> None:
    """Those of the others: in test_robot_dynamics."""
    assert gradgradcheck(robot.regressor, (*states(robot, 2, grad=True), constants(robot)[1]))


@SCRIPTED
@pytest.mark.parametrize("backward", [True, False])
def test_forward_mode_is_left_to_torch(robot: RobotModel, backward: bool) -> None:
    """Whether derivatives are taken backwards as well or not."""
    q, qd, qdd = states(robot, 4)
    with torch.set_grad_enabled(backward), forward_ad.dual_level():
        tau = robot.inverse_dynamics(forward_ad.make_dual(q, torch.ones_like(q)), qd, qdd)
        found = forward_ad.unpack_dual(tau).tangent
        Y = robot.regressor(forward_ad.make_dual(q, torch.ones_like(q)), qd, qdd)
        of_rows = forward_ad.unpack_dual(Y).tangent
    assert found is not None
    assert of_rows is not None
    close(found, robot.torque_slopes(q, qd, qdd)[:, 0].sum(-1))
    close(of_rows @ robot.pi, found)


@pytest.mark.usefixtures("no_eager")
def test_vmap(robot: RobotModel) -> None:
    """Over states, over robots, over both, nested; and gradients of each sample."""
    q, qd, qdd = states(robot, 3, 5)
    pi, gravity = constants(robot, grad=False)
    several = torch.stack([pi, 2 * pi, pi + 0.1])
    for function in functions(robot).values():
        expected = function(q, qd, qdd, pi, gravity)
        close(torch.vmap(function, (0, 0, 0, None, None))(q, qd, qdd, pi, gravity), expected)
        close(torch.vmap(function, (1, 1, 1, None, None), out_dims=1)(q, qd, qdd, pi, gravity), expected)
        looped = torch.stack([function(q[0], qd[0], qdd[0], p, gravity) for p in several])
        close(torch.vmap(function, (None, None, None, 0, None))(q[0], qd[0], qdd[0], several, gravity), looped)
        nested = torch.vmap(torch.vmap(function, (0, 0, 0, None, None)), (0, 0, 0, 0, None))
        looped = torch.stack([function(a, b, c, p, gravity) for a, b, c, p in zip(q, qd, qdd, several, strict=True)])
        close(nested(q, qd, qdd, several, gravity), looped)

        def loss(*x: Tensor, function: Callable[..., Tensor] = function) -> Tensor:
            return function(*x).square().sum()

        argnums = (0, 3, 4)
        each = torch.vmap(torch.func.grad(loss, argnums), (0, 0, 0, None, None))(q, qd, qdd, pi, gravity)
        looped = [torch.func.grad(loss, argnums)(a, b, c, pi, gravity) for a, b, c in zip(q, qd, qdd, strict=True)]
        for k, found in enumerate(each):
            close(found, torch.stack([one[k] for one in looped]))


def test_derivatives_through_vmap(robot: RobotModel) -> None:
    """First and second, of an ensemble."""
    q, qd, qdd = states(robot, 2)
    pi, gravity = constants(robot, grad=False)
    several = torch.stack([pi, 2 * pi, pi + 0.1]).requires_grad_()

    def torques(several: Tensor) -> Tensor:
        return torch.vmap(robot.inverse_dynamics, (None, None, None, 0, None))(q, qd, qdd, several, gravity)

    def looped(several: Tensor) -> Tensor:
        return torch.stack([robot.inverse_dynamics(q, qd, qdd, p, gravity) for p in several])

    found, expected = (torch.autograd.grad(f(several).square().sum(), several) for f in (torques, looped))
    close(found[0], expected[0])
    curvature = [
        torch.func.jacrev(torch.func.grad(lambda x, f=f: f(x).square().sum()))(several) for f in (torques, looped)
    ]
    close(*curvature, 1e-10)


@SCRIPTED
def test_jacobians(robot: RobotModel) -> None:
    q, qd, qdd = states(robot)
    found = torch.func.jacrev(robot.inverse_dynamics, argnums=(0, 1, 2))(q, qd, qdd)
    close(torch.stack(found), robot.torque_slopes(q, qd, qdd))
    by_forward = torch.func.jacfwd(robot.inverse_dynamics)(q, qd, qdd)
    close(by_forward, found[0])


def test_many_weights_at_once(robot: RobotModel) -> None:
    q, qd, qdd = states(robot, grad=True)
    tau = robot.inverse_dynamics(q, qd, qdd)
    found = torch.autograd.grad(tau, (q, qd, qdd), torch.eye(len(tau), dtype=tau.dtype), is_grads_batched=True)
    with torch.no_grad():
        close(torch.stack(found), robot.torque_slopes(q, qd, qdd))


@pytest.mark.parametrize("name", ["inverse_dynamics", "regressor", "mass_matrix"])
def test_traced_in_one_graph(robot: RobotModel, name: str) -> None:
    """As one operator, with its derivative."""
    torch.compiler.reset()
    function = functions(robot)[name]
    x = (*states(robot, 9, grad=True), *constants(robot))
    traced = torch.compile(function, fullgraph=True, backend="aot_eager")
    for a, b in zip(value_and_derivatives(traced, x), value_and_derivatives(function, x), strict=True):
        close(a, b)
    called: list[str] = []

    def keep(graph: torch.fx.GraphModule, _: object) -> Callable[..., object]:
        called.extend(str(node.target) for node in graph.graph.nodes)
        return graph.forward

    torch.compile(function, fullgraph=True, backend=keep)(*x)
    assert f"torchrbd.{name}.default" in called
    torch.compiler.reset()


def test_transforms_in_one_graph(robot: RobotModel) -> None:
    torch.compiler.reset()
    x = states(robot, 3)
    for transform in (torch.vmap, lambda f: torch.vmap(torch.func.grad(lambda *x: f(*x).sum()))):
        traced = torch.compile(transform(robot.inverse_dynamics), fullgraph=True, backend="aot_eager")
        close(traced(*x), transform(robot.inverse_dynamics)(*x))
    torch.compiler.reset()


@pytest.mark.parametrize("name", ["inverse_dynamics", "regressor", "mass_matrix"])
def test_operators_keep_torchs_rules(robot: RobotModel, name: str) -> None:
    """Schema, fake tensors, autograd registration, and the same with a batch of unknown size."""
    q, qd, qdd, pi, gravity = *states(robot, 3, grad=True), *constants(robot)
    given = {"inverse_dynamics": (q, qd, qdd, pi, gravity), "regressor": (q, qd, qdd, gravity), "mass_matrix": (q, pi)}
    torch.library.opcheck(OPERATORS[name], (*given[name], *robot._tables))


def test_exported_without_operators_of_ours(robot: RobotModel) -> None:
    class Torque(torch.nn.Module):
        def forward(self, q: Tensor, qd: Tensor, qdd: Tensor) -> Tensor:
            return robot.inverse_dynamics(q, qd, qdd)

    x = states(robot, 4)
    for strict in (False, True):
        program = torch.export.export(Torque(), x, strict=strict)
        assert not any("torchrbd" in str(node.target) for node in program.graph.nodes)
        close(program.module()(*x), robot.inverse_dynamics(*x))


@pytest.mark.usefixtures("no_eager")
def test_single_precision_is_computed_in_double(robot: RobotModel) -> None:
    x = [v.float().requires_grad_() for v in states(robot, 6)]
    exact = [v.detach().double().requires_grad_() for v in x]
    tau = robot.inverse_dynamics(*x)
    close(tau, robot.inverse_dynamics(*exact).float(), 1e-7)
    tau.sum().backward()
    robot.inverse_dynamics(*exact).sum().backward()
    for a, b in zip(x, exact, strict=True):
        assert a.grad is not None
        assert b.grad is not None
        close(a.grad, b.grad.float(), 1e-7)


def test_other_types_are_left_to_torch(robot: RobotModel) -> None:
    class Marked(Tensor):
        pass

    q, qd, qdd = states(robot, 6)
    expected = robot.inverse_dynamics(q, qd, qdd)
    half = robot.inverse_dynamics(*(x.bfloat16() for x in (q, qd, qdd)))
    assert half.dtype == torch.bfloat16
    negated = torch.complex(qd, -q).conj().imag
    assert negated.is_neg()
    close(robot.inverse_dynamics(negated, qd, qdd), expected)
    marked = robot.inverse_dynamics(q.as_subclass(Marked), qd, qdd)
    assert isinstance(marked, Marked)
    close(marked.as_subclass(Tensor), expected)


def test_copies_are_robots(robot: RobotModel) -> None:
    x = states(robot, 5)
    for twin in (copy.deepcopy(robot), pickle.loads(pickle.dumps(robot)), robot.to(torch.float32)):
        assert torch.equal(twin.mass_matrix(x[0], robot.pi), robot.mass_matrix(x[0]))


def test_log_cholesky() -> None:
    theta = torch.randn(3, 4, 10, dtype=torch.float64, generator=torch.Generator().manual_seed(0)).requires_grad_()
    found = value_and_derivatives(from_log_cholesky, (theta,))
    with compiled.only_eager():
        expected = value_and_derivatives(from_log_cholesky, (theta,))
    for a, b in zip(found, expected, strict=True):
        close(a, b)
    close(torch.vmap(from_log_cholesky, 1, out_dims=1)(theta), found[0])
    assert gradgradcheck(from_log_cholesky, (theta[0, :2],))


def test_torque_of_log_cholesky_coordinates_in_one_call(robot: RobotModel) -> None:
    """The same as in two calls, in every layout; left to them where a derivative or another dtype is wanted."""
    theta = 0.5 * torch.randn(robot.n_bodies, 10, dtype=torch.float64, generator=torch.Generator().manual_seed(5))
    pi = from_log_cholesky(theta).flatten()
    for x in (states(robot), states(robot, 13), states(robot, 3, 2), [y.mT.contiguous().mT for y in states(robot, 9)]):
        found = robot.physical_torque(*x, theta)
        assert found is not None
        close(found, robot.inverse_dynamics(*x, pi))
    q, qd, qdd = states(robot, 13)
    assert robot.physical_torque(q.requires_grad_(), qd, qdd, theta) is None
    with torch.no_grad():
        assert robot.physical_torque(q, qd, qdd, theta) is not None
    q = q.detach()
    assert robot.physical_torque(q, qd[0], qdd, theta) is None
    assert robot.physical_torque(q.float(), qd.float(), qdd.float(), theta) is None
    assert robot.physical_torque(q, qd, qdd, theta[1:]) is None
    assert robot.to(torch.float32).physical_torque(q, qd, qdd, theta) is None
