"""One step of time: against a closed form and MuJoCo, stable where friction is stiff, differentiable."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
import torch
from model.arms import arm, states, term
from robot.random_robots import random_urdf
from robot.test_robot_mujoco import compile_urdf
from torch import Tensor
from torch.autograd import gradcheck

from torchrbd.errors import OptionError, PhysicalError
from torchrbd.model import REST_WIDTH, RigidBodyDynamics
from torchrbd.robot import RobotModel

SLIDE = random_urdf(1, 1, kinds=("prismatic",))


def slide(friction: float) -> RigidBodyDynamics:
    robot = RobotModel.from_urdf(SLIDE, gravity=(0.0, 0.0, 0.0))
    return RigidBodyDynamics(robot, terms=[term("coulomb_friction", 0, friction)])


def rolled(
    model: RigidBodyDynamics, q: Tensor, qd: Tensor, tau: Tensor, dt: float, steps: int
) -> tuple[Tensor, Tensor]:
    for _ in range(steps):
        q, qd = model.step(q, qd, tau, dt)
    return q, qd


def test_a_sliding_mass_stops_and_stays() -> None:
    """Dry friction stops it after m v^2 / 2 F; then it holds what pushes less than it."""
    speed, time, dt = 0.7, 0.1, 1e-3
    mass = float(slide(1.0).robot.pi[0])
    force = mass * speed / time
    model, zero = slide(force), torch.zeros(1, dtype=torch.float64)
    with torch.no_grad():
        q, qd = rolled(model, zero, zero + speed, zero, dt, 120)
        assert abs(float(qd)) < 1e-8
        # Euler's steps have the velocities of their ends.
        assert float(q) == pytest.approx(0.5 * speed * time - 0.5 * speed * dt, rel=1e-3)
        held = rolled(model, q, qd, zero + 0.5 * force, 0.01, 20)[0]
        pushed = rolled(model, q, qd, zero + 1.5 * force, dt, 100)[0]
    assert abs(float(held - q)) < 0.2 * REST_WIDTH
    assert float(pushed - q) == pytest.approx(0.5 * 0.5 * force / mass * 0.1 * (0.1 + dt), rel=1e-2)


@pytest.mark.parametrize("dt", [1e-3, 1e-2])
def test_forces_balance_at_the_end_of_the_step(dt: float) -> None:
    """Friction much stiffer than the step, from rest and from motion."""
    model = arm()
    q, qd, tau = states(model.robot, 64)
    qd = qd * torch.logspace(-6, 0, 64, dtype=qd.dtype)[:, None]
    after, v = model.step(q, qd, tau, dt)
    still = torch.zeros_like(q)
    impulse = (model.mass_matrix(q) @ (v - qd).unsqueeze(-1)).squeeze(-1)
    rigid = model.robot.inverse_dynamics(q, qd, still, model.pi)
    left = impulse / dt + rigid + model.term_torque(q, v, still) - tau
    assert left.abs().max() < 1e-3 * (1.0 + tau.abs().max())
    assert left.abs().median() < 1e-7
    assert torch.equal(after, q + dt * v)


def test_gradients_through_stiff_friction() -> None:
    """Over steps in which the joints turn: as finite differences have them, and no larger than the motion allows."""
    model = arm()
    q, qd, tau = (v.requires_grad_() for v in (x[0] for x in states(model.robot, 1)))
    assert gradcheck(lambda *x: model.step(*x, 2e-3), (q, 1e-3 * qd.detach().requires_grad_(), tau))
    q, qd = q.detach(), qd.detach()

    def end(tau: Tensor) -> Tensor:
        x = q, qd
        for k in range(40):
            x = model.step(*x, model.gravity(x[0]) + tau * np.cos(60.0 * k * 2e-3), 2e-3)
        return x[0]

    assert gradcheck(end, (tau,), eps=1e-6, atol=1e-6, rtol=1e-3)


def test_many_states_are_each_their_own() -> None:
    model = arm()
    q, qd, tau = states(model.robot, 3, 4)
    together = torch.stack(model.step(q, qd, tau, 1e-3))
    alone = [torch.stack(model.step(*x, 1e-3)) for x in zip(q[1], qd[1], tau[1], strict=True)]
    torch.testing.assert_close(together[:, 1], torch.stack(alone, 1), rtol=1e-6, atol=1e-9)
    batched = torch.vmap(lambda *x: torch.stack(model.step(*x, 1e-3)))(q[1], qd[1], tau[1])
    torch.testing.assert_close(batched.movedim(0, 1), together[:, 1], rtol=1e-6, atol=1e-9)


def test_runge_kutta_is_of_fourth_order() -> None:
    """Without friction, against MuJoCo's of the same order, and against itself at half the step."""
    urdf = random_urdf(9, 4)
    model = RigidBodyDynamics(RobotModel.from_urdf(urdf))
    q, qd, tau = (x[0] for x in states(model.robot, 1))
    ends = []
    for steps in (8, 16, 32):
        x = q, qd
        for _ in range(steps):
            x = model.step(*x, tau, 0.1 / steps, method="runge_kutta")
        ends.append(torch.cat(x).detach())
    coarse, fine = (ends[0] - ends[1]).norm(), (ends[1] - ends[2]).norm()
    assert 12.0 < float(coarse / fine) < 20.0
    simulated = compile_urdf(urdf)
    simulated.opt.timestep, simulated.opt.integrator = 0.1 / 32, mujoco.mjtIntegrator.mjINT_RK4
    data = mujoco.MjData(simulated)
    order = [simulated.joint(name).id for name in model.robot.joint_names]
    data.qpos[order], data.qvel[order], data.qfrc_applied[order] = q.numpy(), qd.numpy(), tau.numpy()
    for _ in range(32):
        mujoco.mj_step(simulated, data)
    np.testing.assert_allclose(
        np.concatenate((data.qpos[order], data.qvel[order])), ends[2].numpy(), rtol=1e-8, atol=1e-8
    )


def test_an_unknown_method_is_told_and_so_is_a_body_without_mass() -> None:
    model = arm()
    x = (v[0] for v in states(model.robot, 1))
    with pytest.raises(OptionError, match="method is 'rk4'; expected one of semi_implicit, runge_kutta"):
        model.step(*x, 1e-3, method="rk4")  # type: ignore[arg-type]
    nothing = RigidBodyDynamics(model.robot, torch.zeros_like(model.robot.pi))
    for method in ("semi_implicit", "runge_kutta"):
        with pytest.raises(PhysicalError, match="mass matrix is not positive definite"):
            nothing.step(*(v[0] for v in states(model.robot, 1)), 1e-3, method=method)
