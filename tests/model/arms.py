"""A small arm with friction, rotors and a spring, and states of it."""

from __future__ import annotations

import torch
from robot.random_robots import random_states, random_urdf
from torch import Tensor

from torchrbd.effects import Site, Term, effect
from torchrbd.model import RigidBodyDynamics
from torchrbd.robot import RobotModel

URDF = random_urdf(9, 4, mimic=0.3)


def states(robot: RobotModel, *batch: int, seed: int = 1, grad: bool = False) -> tuple[Tensor, ...]:
    return tuple(torch.from_numpy(x).requires_grad_(grad) for x in random_states(seed, *batch, robot.n_dof))


def term(name: str, joint: int, *coefficients: float) -> Term:
    shape = {"stribeck_speed": 0.3} if name == "stribeck_friction" else {}
    return Term(effect(name), Site(joint), torch.tensor(coefficients, dtype=torch.float64), shape)


def terms() -> list[Term]:
    return [
        term("viscous_friction", 0, 0.7),
        term("stribeck_friction", 1, 0.5, 0.4),
        term("rotor_inertia", 1, 0.3),
        term("rotor_inertia", 2, 0.2),
        term("joint_spring", 2, 3.0, -1.0),
    ]


def arm() -> RigidBodyDynamics:
    return RigidBodyDynamics(RobotModel.from_urdf(URDF), terms=terms())
