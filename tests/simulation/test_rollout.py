"""Rollouts: against MuJoCo, energy, rest under stiff friction, halved steps, batched = looped, moved joints."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import mujoco
import numpy as np
import pytest
import torch
from model.arms import term
from robot.random_robots import random_states, random_urdf
from torch import Tensor

import torchrbd
from torchrbd.effects import JointEffect, JointScale, JointState, Shape, Site, Term, effect, known_effects
from torchrbd.effects.smooth_torque import HUM, SMOOTH
from torchrbd.errors import PhysicalError
from torchrbd.model import RigidBodyDynamics
from torchrbd.robot import RobotModel
from torchrbd.simulation.plant import Conditions, Plant
from torchrbd.simulation.rollout import Drive, rollout

ROBOT = RobotModel.from_urdf(random_urdf(3, 4, kinds=("revolute",), branching=0.0, massless=0.0))
RUBBING = [
    *(term("viscous_friction", j, 0.4) for j in range(4)),
    *(term("coulomb_friction", j, 0.8) for j in range(4)),
    *(term("rotor_inertia", j, 0.3) for j in range(4)),
]


def drive(tau: Tensor, h: float, **more: Tensor) -> Drive:
    """Drive with torques (W, K, n), no joint moved."""
    W, K, n = tau.shape
    still = torch.zeros(W, K + 1, n, dtype=torch.float64)
    given = {"q": still, "qd": still, "qdd": still, "moved": torch.zeros(n, dtype=torch.bool), **more}
    return Drive(h=h, tau=tau, t=torch.zeros(W, dtype=torch.float64), **given)


def begin(windows: int, seed: int = 0) -> tuple[Tensor, Tensor]:
    q, qd, _ = (torch.from_numpy(x) for x in random_states(seed, windows, ROBOT.n_dof))
    return q, qd


def wave(windows: int, steps: int, h: float) -> Tensor:
    """Means over steps of a torque of 1 Hz, of another phase in each window and joint."""
    t = h * (torch.arange(steps, dtype=torch.float64) + 0.5)
    phase = torch.arange(windows * ROBOT.n_dof, dtype=torch.float64).reshape(windows, 1, -1)
    return 6.0 * torch.sin(2.0 * torch.pi * t[:, None] + phase)


def test_as_mujoco_moves_it() -> None:
    """The exported arm, in steps of .25 ms: it differs by MuJoCo's soft dry friction and by the steps of both."""
    model = RigidBodyDynamics(ROBOT, terms=RUBBING)
    simulated = mujoco.MjModel.from_xml_string(torchrbd.to_mjcf(model).decode())
    simulated.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_LIMIT
    simulated.opt.timestep, simulated.opt.integrator = 2.5e-4, mujoco.mjtIntegrator.mjINT_IMPLICIT
    at = [simulated.joint(name).dofadr[0] for name in ROBOT.joint_names]
    q, qd = begin(4)
    tau = wave(4, 100, 5e-3)
    found = rollout(Plant(model), q, qd, drive(tau, 5e-3))[0]
    for w in range(4):
        data = mujoco.MjData(simulated)
        data.qpos[at], data.qvel[at] = q[w].numpy(), qd[w].numpy()
        for k in range(100):
            data.ctrl[:] = tau[w, k].numpy()
            for _ in range(20):
                mujoco.mj_step(simulated, data)
        moved = (found[w, -1] - q[w]).abs().max()
        assert moved > 0.1
        assert np.abs(data.qpos[at] - found[w, -1].numpy()).max() < 4e-3 * float(moved)


def test_energy_stays_without_friction() -> None:
    """Kinetic and potential energy of a free arm over a second; of second order in the step."""
    plant = Plant(RigidBodyDynamics(ROBOT))
    q, qd = begin(8)

    def energy(q: Tensor, qd: Tensor) -> Tensor:
        kinetic = 0.5 * torch.einsum("wi,wij,wj->w", qd, ROBOT.mass_matrix(q), qd)
        R, p = ROBOT.body_poses(q)
        bodies = ROBOT.pi.reshape(-1, 10)
        centres = bodies[:, 0, None] * p + (R @ bodies[:, 1:4, None]).squeeze(-1)
        return kinetic - (centres @ ROBOT.gravity).sum(-1)

    drifts = []
    for h in (4e-3, 2e-3):
        still = torch.zeros(8, round(1.0 / h), 4, dtype=torch.float64)
        path, speed = rollout(plant, q, qd, drive(still, h))
        swing = energy(q, qd) - energy(path[:, -1], speed[:, -1])
        drifts.append(float((swing.abs() / (0.5 * torch.einsum("wi,wij,wj->w", qd, ROBOT.mass_matrix(q), qd))).max()))
    assert drifts[1] < 1e-2
    assert drifts[1] < 0.35 * drifts[0]


def test_what_sticks_stays_however_large_friction_and_step() -> None:
    model = RigidBodyDynamics(ROBOT, terms=[term("coulomb_friction", j, 500.0) for j in range(4)])
    q, qd = begin(16)
    tau = 20.0 * torch.ones(16, 50, 4, dtype=torch.float64)
    path, speed = rollout(Plant(model), q, qd, drive(tau, 0.02))
    assert float(speed[:, 5:].abs().max()) < float(model.rest_width.max())
    assert float((path[:, -1] - path[:, 5]).abs().max()) < 0.9 * float(model.rest_width.max())


def test_half_the_step_changes_little() -> None:
    """Smooth forces: the order is two. Dry friction that turns: well below what models err by."""
    q, qd = begin(16)
    smooth = Plant(RigidBodyDynamics(ROBOT, terms=[t for t in RUBBING if t.effect.id != "coulomb_friction"]))
    rubbing = Plant(RigidBodyDynamics(ROBOT, terms=RUBBING))

    def ends(plant: Plant, h: float) -> Tensor:
        # The same torque, held over 20 ms.
        tau = wave(16, 25, 0.02).repeat_interleave(round(0.02 / h), 1)
        return rollout(plant, q, qd, drive(tau, h))[0][:, -1]

    coarse, middle, fine = (ends(smooth, h) for h in (1e-2, 5e-3, 2.5e-3))
    assert 3.0 < float((coarse - middle).norm() / (middle - fine).norm()) < 5.0
    assert float((ends(rubbing, 5e-3) - ends(rubbing, 2.5e-3)).abs().median()) < 2e-4
    assert float((ends(rubbing, 5e-3) - ends(rubbing, 2.5e-3)).abs().max()) < 5e-3


def test_batched_is_looped() -> None:
    q, qd = begin(5)
    tau = wave(5, 40, 5e-3)
    terms = [*RUBBING, term("stribeck_friction", 1, 0.5, 0.4), term("torque_scale", 2, 0.1)]
    plant = Plant(RigidBodyDynamics(ROBOT, terms=terms))
    together = rollout(plant, q, qd, drive(tau, 5e-3))[0]
    alone = torch.cat([rollout(plant, q[w, None], qd[w, None], drive(tau[w, None], 5e-3))[0] for w in range(5)])
    torch.testing.assert_close(together, alone, rtol=0.0, atol=1e-6)


def test_joints_that_are_moved_drive_the_others() -> None:
    """A motion, its first joint's torque unknown: the others move as before."""
    plant = Plant(RigidBodyDynamics(ROBOT, terms=[t for t in RUBBING if t.effect.id != "coulomb_friction"]))
    q, qd = begin(6)
    tau = wave(6, 200, 1e-3)
    path, speed = rollout(plant, q, qd, drive(tau, 1e-3))
    accelerated = torch.gradient(speed, spacing=1e-3, dim=1)[0]
    moved = torch.tensor([True, False, False, False])
    unknown = tau.masked_fill(moved, 0.0)
    given = drive(unknown, 1e-3, q=path, qd=speed, qdd=accelerated, moved=moved)
    again = rollout(plant, q, qd, given)[0]
    assert torch.equal(again[..., 0], path[..., 0])
    assert float((again - path).abs().max()) < 2e-4
    assert float((rollout(plant, q, qd, drive(unknown, 1e-3))[0] - path).abs().max()) > 1e-2


def test_a_lost_motion_is_told_and_hurts_no_other() -> None:
    plant = Plant(RigidBodyDynamics(ROBOT, terms=RUBBING))
    q, qd = begin(3)
    tau = wave(3, 40, 5e-3)
    pushed = tau.clone()
    pushed[1] = 1e9
    found, calm = (rollout(plant, q, qd, drive(x, 5e-3))[0] for x in (pushed, tau))
    assert bool(found[1, -1].isnan().all())
    torch.testing.assert_close(found[[0, 2]], calm[[0, 2]], rtol=0.0, atol=1e-6)


def test_a_body_without_mass_is_told_with_its_joint() -> None:
    light = RobotModel.from_urdf(random_urdf(3, 1, kinds=("revolute",)))
    plant = Plant(RigidBodyDynamics(light, torch.zeros_like(light.pi)))
    q = torch.zeros(1, 1, dtype=torch.float64)
    with pytest.raises(PhysicalError, match=f"first at joint '{light.joint_names[0]}'"):
        rollout(plant, q, q, drive(torch.zeros(1, 1, 1, dtype=torch.float64), 1e-3))


def test_effects_say_whether_they_have_memory() -> None:
    """Those that have none are defined on single states, the others are refused there."""
    still = torch.zeros(1, 2, ROBOT.n_dof, dtype=torch.float64)
    for one in (*known_effects().values(), *SMOOTH, HUM):
        shape = one.shapes(torchrbd.effects.JointScale(1.0, 1e-3, load_max=1.0, temperature=(20.0, 50.0)))[0]
        windows = (torchrbd.effects.Window("a", 0.0, 1.0),)
        site = next(iter(one.sites(ROBOT, windows)))
        count = len(one.coefficients({name: 1.0 for name in one.units})[0])
        model = RigidBodyDynamics(ROBOT, terms=[Term(one, site, torch.ones(count, dtype=torch.float64), shape)])
        try:
            model.bias_forces(still, still, torch.zeros(1, 2, dtype=torch.float64))
        except torchrbd.InputError:
            assert one.has_memory, one.id
        else:
            assert not one.has_memory, one.id


def test_presliding_friction_moves_as_the_coulomb_friction_that_it_becomes() -> None:
    q, qd = begin(4)
    tau = wave(4, 40, 5e-3)
    bristles = Term(
        effect("presliding_hysteresis"), Site(1), torch.tensor([2.0], dtype=torch.float64), {"distance": 0.01}
    )
    found, plain = (
        rollout(Plant(RigidBodyDynamics(ROBOT, terms=[one])), q, qd, drive(tau, 5e-3))[0]
        for one in (bristles, term("coulomb_friction", 1, 2.0))
    )
    assert torch.equal(found, plain)


def test_a_plant_has_the_mass_and_torques_of_its_model() -> None:
    """Terms by joint and terms of the module, at some time of a recording."""
    window = torchrbd.effects.Window("day", 1.0, 2.0)
    terms = [
        *RUBBING,
        term("asymmetric_coulomb_friction", 0, 0.7, 0.2),
        term("torque_offset", 3, 0.4),
        term("joint_spring", 2, 3.0, -1.0),
        term("torque_scale", 1, 0.1),
        Term(effect("torque_offset"), Site(1, window=window), torch.tensor([5.0], dtype=torch.float64), {}),
        Term(effect("rotor_inertia"), Site(2, recordings=("day",)), torch.tensor([0.2], dtype=torch.float64), {}),
    ]
    model = RigidBodyDynamics(ROBOT, terms=terms)
    plant, (q, qd) = Plant(model), begin(6)
    t = torch.linspace(0.5, 2.5, 6, dtype=torch.float64)
    assert plant.conditional
    for recording in (None, "day"):
        at = Conditions(t, recording=recording)
        bias = model.bias_forces(q[None], qd[None], t[None], recording=recording)[0]
        torch.testing.assert_close(plant.rigid(q, qd) + plant.terms(q, at)(qd), bias, rtol=1e-9, atol=1e-9)
        mass = model.mass_matrix(q[None], t[None], recording=recording)[0]
        torch.testing.assert_close(plant.mass(q, at), mass, rtol=1e-9, atol=1e-9)


class Sided(JointEffect):
    """tau += level where the joint moves forwards: it follows the velocity, by which it has no derivative."""

    id, words, equation = "test_sided", "a sided torque", "level (qd > 0)"
    units: ClassVar[Mapping[str, str]] = {"level": "{tau}"}

    def joint_features(self, state: JointState, shape: Shape) -> dict[str, Tensor]:
        return {"test sided": (state.qd > 0).to(state.q)}

    def parameters(self, coefficients: Tensor, shape: Shape) -> dict[str, Tensor]:
        return {"level": coefficients[0]}

    def coefficients(self, parameters: Mapping[str, float]) -> tuple[tuple[float, ...], Shape]:
        return (parameters["level"],), {}

    def plausible(self, parameters: Mapping[str, float], scale: JointScale) -> bool:
        return True


@pytest.mark.parametrize(
    ("one", "moves"),
    [
        (term("joint_spring", 2, 3.0, -1.0), False),
        (term("quadratic_drag", 1, 2.0), True),
        (Term(Sided(), Site(0), torch.tensor([1.0], dtype=torch.float64), {}), True),
        (
            Term(
                Sided(), Site(0, window=torchrbd.effects.Window("day", 3.0, 4.0)),
                torch.tensor([1.0], dtype=torch.float64), {},
            ),
            True,
        ),
    ],
    ids=["a spring", "drag", "by comparison", "by comparison, for a time"],
)  # fmt: skip
def test_what_depends_on_the_velocity_is_computed_at_each(one: Term, moves: bool) -> None:
    plant, (q, qd) = Plant(RigidBodyDynamics(ROBOT, terms=[one])), begin(4)
    torque = plant.terms(q, Conditions(torch.full((4,), 3.5, dtype=torch.float64), recording="day"))
    assert torch.equal(torque(qd), torque(-qd)) is not moves
