"""Fleets of robots as they would be identified: true parameters that scatter, and errors; no recordings."""

from __future__ import annotations

import numpy as np
from inference.problems import urdf_of

from torchrbd import RobotModel
from torchrbd.comparison.reading import Inertia
from torchrbd.diagnosis.results import Quantity
from torchrbd.fleet.results import Member
from torchrbd.parameters import base_parameters

ROBOT = RobotModel.from_urdf(urdf_of(3, 3).encode())
BASE = base_parameters(ROBOT)
K, PI = BASE.combination.numpy(), ROBOT.pi.numpy()
# Relative standard deviation of what identification tells.
ACCURACY = 0.01


def member(
    k: int, rng: np.random.Generator, *, scatter: float = 0.0, pi: np.ndarray = PI, friction: float = 1.0
) -> Member:
    """Return a robot as it would be identified: true parameters with scatter from robot to robot, and errors."""
    size = np.abs(K) @ np.abs(PI)
    std = ACCURACY * size * rng.uniform(0.5, 2.0, len(size))
    beta = K @ pi + scatter * size * rng.standard_normal(len(size)) + std * rng.standard_normal(len(size))
    inertia = Inertia(
        BASE.names, K, pi, beta, np.diag(std**2), np.zeros(len(size)), BASE.expressions, ("kg",) * len(size)
    )
    terms = {}
    for joint in ROBOT.joint_names:
        for key, size in (("viscous", 0.5), ("coulomb", 1.5)):
            true = size * (1.0 + scatter * rng.standard_normal()) * (friction if joint == "joint2" else 1.0)
            error = ACCURACY * size * rng.uniform(0.5, 2.0)
            value = true + error * rng.standard_normal()
            terms[f"{key}_friction_{joint}.{key}"] = Quantity(float(value), float(error), "N m")
    bodies = tuple(body for body in ROBOT.body_names for _ in range(10))
    return Member(f"arm{k}", ROBOT.name, "identified", 1e-3, inertia, bodies, terms, ())


def fleet(n: int, seed: int, scatter: float = 0.0) -> list[Member]:
    """Return equal robots, up to their scatter."""
    rng = np.random.default_rng(seed)
    return [member(k, rng, scatter=scatter) for k in range(n)]
