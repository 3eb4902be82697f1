"""What must hold for any robot: identities, derivatives, batches."""

from __future__ import annotations

import pytest
import torch
from robot.random_robots import random_states, random_urdf
from shortened import slow_but
from torch import Tensor
from torch.autograd import gradcheck, gradgradcheck

from torchrbd.errors import InputError, PhysicalError
from torchrbd.robot import RobotModel, transform_inertia

MIXED = random_urdf(9, 4, mimic=0.3)
"""Four bodies, revolute and prismatic, branches, one mimic joint."""


@pytest.fixture(scope="module")
def robot() -> RobotModel:
    robot = RobotModel.from_urdf(MIXED)
    assert robot.n_bodies == 4
    assert robot.n_dof == 3
    return robot


def states(robot: RobotModel, *batch: int, grad: bool = False) -> tuple[Tensor, ...]:
    return tuple(torch.from_numpy(x).requires_grad_(grad) for x in random_states(1, *batch, robot.n_dof))


def test_regressor_times_parameters_is_inverse_dynamics(robot: RobotModel) -> None:
    x = states(robot, 50)
    pi = torch.randn(robot.n_params, dtype=torch.float64)
    torch.testing.assert_close(robot.regressor(*x) @ pi, robot.inverse_dynamics(*x, pi=pi), rtol=1e-11, atol=1e-11)


def test_torque_is_affine_in_acceleration(robot: RobotModel) -> None:
    q, qd, qdd = states(robot, 20)
    inertial = robot.inverse_dynamics(q, qd, qdd) - robot.inverse_dynamics(q, qd, torch.zeros_like(q))
    torch.testing.assert_close(inertial, (robot.mass_matrix(q) @ qdd[..., None])[..., 0])


def test_power_without_gravity_is_the_change_of_kinetic_energy(robot: RobotModel) -> None:
    q, qd, qdd = states(robot)
    tau = robot.inverse_dynamics(q, qd, qdd, gravity=torch.zeros(3))
    t = torch.zeros((), dtype=torch.float64, requires_grad=True)
    velocity = qd + qdd * t
    energy = velocity @ robot.mass_matrix(q + qd * t) @ velocity / 2
    torch.testing.assert_close(torch.autograd.grad(energy, t)[0], qd @ tau)


def test_gravity_torque_is_the_gradient_of_potential_energy(robot: RobotModel) -> None:
    q, *_ = states(robot, grad=True)
    rotation, origin = robot.body_poses(q)
    pi = robot.pi.unflatten(0, (-1, 10))
    first_moment = pi[:, :1] * origin + (rotation @ pi[:, 1:4, None])[..., 0]
    (expected,) = torch.autograd.grad(-(first_moment @ robot.gravity).sum(), q)
    still = torch.zeros_like(q)
    torch.testing.assert_close(robot.inverse_dynamics(q, still, still), expected)


def test_forward_dynamics_inverts_inverse_dynamics(robot: RobotModel) -> None:
    q, qd, qdd = states(robot, 2, 5)
    tau = robot.inverse_dynamics(q, qd, qdd)
    torch.testing.assert_close(robot.forward_dynamics(q, qd, tau), qdd)


def test_columns_hold_all_that_is_not_zero() -> None:
    for seed in range(6):
        robot = RobotModel.from_urdf(random_urdf(seed, 7, mimic=0.3 * (seed % 2)))
        largest = robot.regressor(*states(robot, 30)).abs().amax(0)
        for joint in range(robot.n_dof):
            other = torch.ones(robot.n_params, dtype=torch.bool)
            other[robot.columns(joint)] = False
            assert largest[joint, other].eq(0).all()
            assert largest[joint, ~other].count_nonzero() > 0
    torch.testing.assert_close(robot.columns(-1), robot.columns(robot.n_dof - 1))


@pytest.mark.parametrize("batch", [(), (1,), (0,), (2, 3), (4097,)])
def test_batched_is_looped(robot: RobotModel, batch: tuple[int, ...]) -> None:
    q, qd, qdd = states(robot, *batch)
    calls = {
        "regressor": (q, qd, qdd),
        "inverse_dynamics": (q, qd, qdd),
        "forward_dynamics": (q, qd, qdd),
        "mass_matrix": (q,),
    }
    for name, x in calls.items():
        method = getattr(robot, name)
        batched = method(*x)
        assert batched.shape[: len(batch)] == batch
        flat = [y.reshape(-1, robot.n_dof) for y in x]
        result = batched.reshape(-1, *batched.shape[len(batch) :])
        for k in {0, 1, 2047, 2048, 4096} & set(range(len(result))):
            torch.testing.assert_close(result[k], method(*(y[k] for y in flat)), rtol=1e-12, atol=1e-12)


def test_batches_broadcast(robot: RobotModel) -> None:
    q, qd, qdd = states(robot, 5)
    torch.testing.assert_close(
        robot.regressor(q, qd[0], qdd[:1]), robot.regressor(q, qd[:1].expand(5, -1), qdd[:1].expand(5, -1))
    )


def test_batch_last_is_the_same_memory_order(robot: RobotModel) -> None:
    q, qd, qdd = states(robot, 10)
    last = robot.regressor_batch_last(q.T, qd.T, qdd.T)
    assert last.is_contiguous()
    assert torch.equal(last.movedim(-1, 0), robot.regressor(q, qd, qdd))


def test_written_and_differentiable_regressor_agree(robot: RobotModel) -> None:
    for model in (robot, RobotModel.from_urdf(random_urdf(3, 9))):
        plain = model.regressor(*states(model, 6))
        tracked = model.regressor(*states(model, 6, grad=True))
        assert tracked.requires_grad
        torch.testing.assert_close(plain, tracked.detach(), rtol=1e-13, atol=1e-13)


@pytest.mark.parametrize(
    "urdf", slow_but((MIXED,), (MIXED, random_urdf(2, 3, kinds=("revolute",)))), ids=["mixed", "revolute"]
)
def test_gradients(urdf: str) -> None:
    robot = RobotModel.from_urdf(urdf)
    q, qd, qdd = states(robot, 2, grad=True)
    pi = robot.pi.clone().requires_grad_()
    gravity = torch.tensor([0.3, -1.0, -9.0], dtype=torch.float64, requires_grad=True)
    assert gradcheck(robot.regressor, (q, qd, qdd, gravity))
    assert gradcheck(robot.inverse_dynamics, (q, qd, qdd, pi, gravity))
    assert gradgradcheck(robot.inverse_dynamics, (q, qd, qdd, pi, gravity))
    assert gradcheck(robot.mass_matrix, (q, pi))
    assert gradgradcheck(robot.mass_matrix, (q, pi))
    assert gradcheck(robot.forward_dynamics, (q, qd, qdd, pi, gravity))
    assert gradcheck(robot.body_poses, (q,))


def test_gravity_can_be_set(robot: RobotModel) -> None:
    x = states(robot, 3)
    tilted = (1.0, 0.0, -9.0)
    there = robot.with_gravity(tilted)
    assert robot.gravity.tolist() == [0.0, 0.0, -9.81]
    expected = RobotModel.from_urdf(MIXED, gravity=tilted).inverse_dynamics(*x)
    assert torch.equal(there.inverse_dynamics(*x), expected)
    assert torch.equal(robot.inverse_dynamics(*x, gravity=torch.tensor(tilted)), expected)


def test_dtype_follows_the_input(robot: RobotModel) -> None:
    x = states(robot, 8)
    single = [y.float() for y in x]
    for method in (robot.regressor, robot.inverse_dynamics):
        assert method(*single).dtype == torch.float32
        scale = method(*x).abs().max()
        assert (method(*single) - method(*x)).abs().max() < 1e-5 * scale
    assert robot.to(torch.float32).pi.dtype == torch.float32
    assert robot.to(torch.float32).prismatic.dtype == torch.bool
    assert robot.pi.dtype == torch.float64


def test_folded_links_add_up() -> None:
    robot = RobotModel.from_urdf(random_urdf(4, 8, fixed=0.9))
    for body, pi in zip(robot.body_names, robot.pi.split(10), strict=True):
        links = robot.folded[body]
        assert links[0].name == body
        assert torch.equal(links[0].pose, torch.eye(4, dtype=torch.float64))
        torch.testing.assert_close(sum(transform_inertia(link.pi, link.pose) for link in links), pi)
    assert sum(map(len, robot.folded.values())) > robot.n_bodies


def test_impossible_inertia_is_told(robot: RobotModel) -> None:
    q, qd, tau = states(robot, 4)
    with pytest.raises(
        PhysicalError, match=r"mass matrix is not positive definite at 4 of 4 positions, first at joint"
    ):
        robot.forward_dynamics(q, qd, tau, pi=-robot.pi)


def test_wrong_sizes_are_told(robot: RobotModel) -> None:
    q, qd, qdd = states(robot, 4)
    with pytest.raises(InputError, match=r"shape \(4, 2\), expected \(..., 3\): robot 'random9' has joints "):
        robot.inverse_dynamics(q, qd[:, :2], qdd)
    with pytest.raises(InputError, match=r"pi has shape \(10,\), expected \(40,\)"):
        robot.mass_matrix(q, pi=robot.pi[:10])
    with pytest.raises(InputError, match=r"shape \(4, 3\), expected \(3, N\)"):
        robot.regressor_batch_last(q, qd, qdd)
    with pytest.raises(InputError, match=r"shape \(4, 1\), expected \(..., 3\)"):
        robot.forward_dynamics(q, qd, qdd[:, :1])
    with pytest.raises(InputError, match=r"gravity has shape \(\), expected \(3,\)"):
        robot.inverse_dynamics(q, qd, qdd, gravity=torch.tensor(9.81))
