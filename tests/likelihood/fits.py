"""Fits that are learnt once for all tests of a run."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pinocchio as pin
from likelihood.arms import Torque, arm_urdf, friction, recorded, rows_of, wrong_robot
from simulated import Motion, inverse_dynamics

from torchrbd.dataset.columns import Candidate
from torchrbd.dataset.rows import Rows
from torchrbd.effects import Site
from torchrbd.effects.registry import effect
from torchrbd.likelihood.learning import learn
from torchrbd.likelihood.likelihood import Likelihood
from torchrbd.likelihood.machine import Machine
from torchrbd.likelihood.noise import Student, Tail

URDF = arm_urdf(0, 2)
VISCOUS, COULOMB, WIDTH, DELAY_S = (0.4, 0.2), (1.0, 0.3), 0.05, 0.004
BEGIN_S, MASS, CENTRE = 10.3, 0.5, np.array([0.05, 0.1, 0.1])
OPTIONS = {"duration_s": 20.0, "rate_hz": 100.0, "encoder_noise": 1e-5}


def tail_of(weight: np.ndarray) -> Tail:
    """Return the tail of rows (M,) of these weights, each Student's t for itself."""
    return Tail((Student(4.0, weight),))


def with_friction(more: Torque | None = None) -> Torque:
    ordinary = friction(VISCOUS, COULOMB, WIDTH)
    return ordinary if more is None else lambda m: ordinary(m) + more(m)


def at_joint(joint: int, torque: Torque) -> Torque:
    """Return a torque (N,) as that of one of two joints."""

    def whole(m: Motion) -> np.ndarray:
        return np.eye(2)[joint] * np.asarray(torque(m))[:, None]

    return whole


def payload(m: Motion) -> np.ndarray:
    """Return what a point mass on the last link adds from ``BEGIN_S`` on, by Pinocchio."""
    model = pin.buildModelFromXML(URDF)
    model.inertias[2] = model.inertias[2] + pin.Inertia(MASS, CENTRE, np.zeros((3, 3)))
    data = model.createData()
    loaded = np.stack([pin.rnea(model, data, *row).copy() for row in zip(m.q, m.qd, m.qdd, strict=True)])
    return (loaded - inverse_dynamics(URDF, m)) * (m.t >= BEGIN_S)[:, None]


@lru_cache(maxsize=32)
def fitted(more: Torque | None = None, gain: float = 1.0, delay_s: float = 0.0, seed: int = 2) -> Likelihood:
    """Return what is learnt of a recording of an arm whose URDF is wrong by a tenth."""
    robot = wrong_robot(URDF, 1)
    robot.pi.mul_(gain)
    return learn(
        Machine(rows_of(robot, [recorded(URDF, seed, with_friction(more), gain=gain, delay_s=delay_s, **OPTIONS)]))
    )


def carried(fit: Likelihood) -> Rows:
    """Return the rows whose signals carry the load and friction of a fit."""
    return fit.machine.rows.around(fit.pi, fit.hyper.friction, fit.hyper.rest_width)


def candidate(rows: Rows, name: str, site: Site, **shape: float) -> Candidate:
    return rows.columns.candidate(effect(name), site, shape)
