"""Training a robot's parameters: in few passes, in any units of the loss, without leaving what is physical."""

from __future__ import annotations

import copy

import pytest
import torch
from model.arms import arm, states
from torch import Tensor

import torchrbd
from torchrbd.errors import InputError, OptionError
from torchrbd.learning import NaturalGradient, parameter_groups
from torchrbd.model import RigidBodyDynamics
from torchrbd.parameters import is_physical

NOISE, BATCH = 0.05, 64


def data(n: int = 640) -> tuple[Tensor, ...]:
    """Return states and noisy torques of a robot, (n, n_dof) each."""
    robot = arm()
    x = states(robot.robot, n)
    tau = robot(*x).detach()
    return (*x, tau + NOISE * torch.randn(tau.shape, generator=torch.Generator().manual_seed(3), dtype=tau.dtype))


def other(seed: int = 5) -> RigidBodyDynamics:
    """Return the robot with bodies 30 % and coefficients far off."""
    robot, generator = arm(), torch.Generator().manual_seed(seed)
    with torch.no_grad():
        robot.raw_inertia += 0.3 * torch.randn(robot.raw_inertia.shape, generator=generator, dtype=torch.float64)
        for term in robot.terms:
            term.coefficients.zero_()
    return robot


def loss(robot: RigidBodyDynamics, x: tuple[Tensor, ...], weight: Tensor) -> Tensor:
    return (0.5 * weight * (robot(*x[:3]) - x[3]).square()).sum(-1).mean()


def train(robot: RigidBodyDynamics, x: tuple[Tensor, ...], weight: Tensor, epochs: int) -> NaturalGradient:
    optimiser = NaturalGradient(robot)
    schedule = torch.optim.lr_scheduler.LambdaLR(optimiser, lambda epoch: 1.0 / (1.0 + epoch))
    for epoch in range(epochs):
        for rows in torch.randperm(len(x[0]), generator=torch.Generator().manual_seed(epoch)).split(BATCH):
            batch = tuple(v[rows] for v in x)
            optimiser.zero_grad()
            loss(robot, batch, weight).backward()
            if not epoch:
                optimiser.observe(*batch[:3], weight)
            optimiser.step()
        schedule.step()
    return optimiser


@pytest.mark.parametrize("unit", [1.0, 1e6])
def test_five_passes_reach_the_batch_solution(unit: float) -> None:
    """No robot fits better than the least loss, and the true one fits at most a little worse."""
    x, robot = data(), other()
    weight = unit / x[3].var(0)
    before, truth = (float(loss(r, x, weight).detach()) for r in (robot, arm()))
    train(robot, x, weight, epochs=5)
    after = float(loss(robot, x, weight).detach())
    assert after < 1.01 * truth < 0.01 * before
    assert bool(is_physical(robot.pi.reshape(-1, 10)).all())


def test_a_first_step_from_afar_stays_physical() -> None:
    x, robot = data(32), other()
    optimiser = NaturalGradient(robot, damping=1e-12)
    weight = 1.0 / x[3].var(0)
    with torch.no_grad():
        robot.raw_inertia[:, 0] += 3.0
    loss(robot, x, weight).backward()
    optimiser.observe(*x[:3], weight)
    optimiser.step()
    assert bool(is_physical(robot.pi.reshape(-1, 10)).all())


def test_an_optimiser_is_saved_and_goes_on() -> None:
    x = data(128)
    weight = 1.0 / x[3].var(0)
    one = other()
    optimiser = train(one, x, weight, epochs=1)
    two = other()
    two.load_state_dict(one.state_dict())
    again = NaturalGradient(two)
    again.load_state_dict(copy.deepcopy(optimiser.state_dict()))
    for robot, own in ((one, optimiser), (two, again)):
        own.zero_grad()
        loss(robot, x, weight).backward()
        own.step()
    assert all(torch.equal(a, b) for a, b in zip(one.parameters(), two.parameters(), strict=True))


def test_what_is_wrong_is_said() -> None:
    robot = arm()
    with pytest.raises(OptionError, match="observe"):
        NaturalGradient(robot).step()
    with pytest.raises(OptionError, match="positive"):
        NaturalGradient(robot, lr=0.0)
    x = states(robot.robot, 4)
    with pytest.raises(InputError, match="not finite"):
        parameter_groups(robot, *x, torch.full((4, 3), torch.nan))


def test_groups_move_torque_by_the_same_part() -> None:
    """A step of Adam moves each coefficient by its rate: its torque by ``lr`` of the joint's."""
    robot, x = arm(), data()
    groups = torchrbd.parameter_groups(robot, *x, lr=0.02)
    assert [g["params"][0] for g in groups] == list(robot.parameters())
    assert groups[0]["lr"] == 0.02
    for group, term in zip(groups[1:], robot.terms, strict=True):
        moved = arm()
        with torch.no_grad():
            own = next(t for t in moved.terms if t.site == term.site and t.effect.id == term.effect.id).coefficients
            felt = []
            for k in range(len(own)):
                own[k] += group["lr"]
                felt.append((moved(*x[:3]) - robot(*x[:3])).square().mean(0).sqrt() / x[3].square().mean(0).sqrt())
                own[k] -= group["lr"]
        assert float(torch.stack(felt).max()) == pytest.approx(0.02)


def test_float32_and_what_no_data_tell() -> None:
    """A spring of a joint that never moves is left alone by the data, and moved by nothing else."""
    still = [v * torch.tensor([1.0, 1.0, 0.0]) for v in data(256)[:3]]
    x = tuple(v.float() for v in (*still, arm()(*still).detach()))
    robot = other().float()
    held = robot.terms[4].coefficients.detach().clone()
    before = float(loss(robot, x, 1.0 / x[3].var(0)).detach())
    train(robot, x, 1.0 / x[3].var(0), epochs=2)
    assert float(loss(robot, x, 1.0 / x[3].var(0)).detach()) < 0.05 * before
    assert float((robot.terms[4].coefficients - held)[0].abs().detach()) < 1e-3
    assert robot.raw_inertia.dtype == torch.float32
