"""Initial terms of a model, before any data: those of the URDF, and zeros to train."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch

from torchrbd.effects import Effect, JointScale, Shape, Signals, Site, Term, effect
from torchrbd.effects.registry import tagged_effects
from torchrbd.effects.requested import RequestedEffect
from torchrbd.errors import OptionError
from torchrbd.robot import RobotModel

REST_WIDTH = 1e-3
"""Softness of the sign of velocity [rad/s, m/s] before any recording determines it."""
_ROOM_AND_WARM = 20.0, 50.0


def described_terms(robot: RobotModel) -> list[Term]:
    """Return the terms in a robot's description: damping, dry friction, rotors and springs of its joints."""
    terms = []
    for joint in range(robot.n_dof):
        for e in tagged_effects():
            if value := getattr(robot, e.urdf_tag)[joint]:
                terms.append(Term(e, Site(joint), value.reshape(1), {}))
    return [*terms, *known_terms(robot)]


def known_terms(robot: RobotModel) -> list[Term]:
    """Return the terms whose torque is ``RobotModel.known_torque``: rotors and springs."""
    terms = []
    for joint in range(robot.n_dof):
        if robot.armature[joint]:
            terms.append(Term(effect("rotor_inertia"), Site(joint), robot.armature[joint].reshape(1), {}))
        if k := robot.stiffness[joint]:
            terms.append(Term(effect("joint_spring"), Site(joint), torch.stack((k, -k * robot.rest[joint])), {}))
    return terms


def starting_terms(robot: RobotModel, effects: Sequence[str]) -> list[Term]:
    """Return terms with zero torque to train: "viscous_friction" at all its places, or "joint_spring@joint2".

    Raises:
        OptionError: an unknown effect or place, or an effect that acts for a time only.
    """
    terms = []
    for one in map(RequestedEffect.parse, effects):
        if one.window is not None or not (sites := one.sites(robot, ())):
            raise OptionError(
                f"'{one.effect.id}' acts for a time only; a model that knows no recording can have no such term"
            )
        for site in sites:
            shapes = one.effect.shapes(_scale(robot, site.joint or 0))
            if not shapes:
                raise OptionError(f"'{one.effect.id}' has no shape within the limits of '{robot.name}': leave it out")
            shape = shapes[len(shapes) // 2]
            zeros = torch.zeros(_count(one.effect, robot, site, shape), dtype=torch.float64)
            terms.append(Term(one.effect, site, zeros, shape))
    return terms


def _scale(robot: RobotModel, joint: int) -> JointScale:
    """Return the range of a joint from its limits; without limits, one turn and one turn per second."""
    low, high, speed, effort = (float(x[joint]) for x in (robot.lower, robot.upper, robot.velocity, robot.effort))
    return JointScale(
        speed_max=speed if math.isfinite(speed) else 2.0 * math.pi,
        rest_width=REST_WIDTH,
        q_low=low if math.isfinite(low) else -math.pi,
        q_high=high if math.isfinite(high) else math.pi,
        load_max=effort if math.isfinite(effort) else None,
        temperature=_ROOM_AND_WARM,
    )


def _count(effect: Effect, robot: RobotModel, site: Site, shape: Shape) -> int:
    """Return the number of an effect's coefficients."""
    t = torch.arange(2, dtype=torch.float64)
    still = torch.zeros(robot.n_dof, 2, dtype=torch.float64)
    signals = Signals(robot, still, still, still, torch.full((robot.n_dof,), REST_WIDTH, dtype=torch.float64), t=t)
    return len(effect.features(signals, site, shape))
