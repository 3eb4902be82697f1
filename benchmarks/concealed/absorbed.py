"""Effects that a recording cannot tell from other inertials, from an offset, or from nothing at all."""

from __future__ import annotations

import numpy as np

from .contract import Effect
from .joint_torques import JointSpring
from .motion import Motion
from .sensors import EncoderOffset, TorqueScale
from .simulate import Refused
from .sizes import Yardstick
from .whole_robot import GeometryError, Payload, RotorInertia


def absorbed_effect(rng: np.random.Generator, kind: str, size: float, yardstick: Yardstick, held: int | None) -> Effect:
    """Draw one of ``tiers.ABSORBED``; its size before projection is the one asked for, if it has any.

    Raises:
        Refused: this robot has no such effect.
    """
    x = yardstick.motions[0]
    if kind == "encoder_offset_of_vertical_first_joint":
        _first_axis_vertical(x)
        return EncoderOffset.draw(rng, x, 0).of_strength(float(rng.uniform(0.03, 0.15)))
    if kind == "base_moved":
        effect = GeometryError.draw(rng, x, 0).of_strength(float(rng.uniform(0.02, 0.08)))
        shift = rng.standard_normal(3)
        effect.direction = np.array([*(shift / np.linalg.norm(shift)), 0.0, 0.0, 0.0])
        return effect
    return yardstick.scaled(_unscaled(rng, kind, x, held), size, raw=True)


def _unscaled(rng: np.random.Generator, kind: str, x: Motion, held: int | None) -> Effect:
    last = x.robot.n - 1
    if kind == "rotor_inertia_of_first_joint":
        return RotorInertia.draw(rng, x, 0)
    if kind == "payload_always_there":
        return Payload.draw(rng, x, int(rng.integers(last // 2, last + 1)))
    if kind == "gain_of_all_torques":
        return TorqueScale.draw(rng, x, -1)
    if kind == "encoder_offset_of_last_joint":
        return EncoderOffset.draw(rng, x, last)
    if kind == "spring_at_a_fixed_angle" and held is not None:
        return JointSpring(held, 1.0, float(x.q[0, held] + rng.choice([-1.0, 1.0]) * rng.uniform(0.3, 1.0)))
    raise ValueError(f"no absorbed effect is called '{kind}'")


def _first_axis_vertical(x: Motion) -> None:
    axis = x.robot.model.jointPlacements[1].rotation @ np.asarray(x.robot.model.joints[1].createData().S)[3:].ravel()
    if abs(axis[2]) < 1.0 - 1e-9:
        raise Refused("the first joint's axis is not vertical")
