"""Concealed effects at one joint, per unit of strength: levels of dry friction, pushes, and what a recorder does.

``x`` is a ``Motion`` or one step of it: t, q, v, load (..., n). An effect's torque adds to the actuator's.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

Shape = Mapping[str, float]


@dataclass(frozen=True)
class Motion:
    """What is true along a recording: t (N,), all else (N, n).

    Attributes:
        q, v, a: of the joints [rad], [rad/s], [rad/s^2].
        load: torque of the rigid body [N m].
        direction: of friction, from -1 to 1.
        supplied: torque of the actuators but for the effect [N m].
    """

    t: np.ndarray
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    load: np.ndarray
    direction: np.ndarray
    supplied: np.ndarray


@dataclass(frozen=True)
class Effect:
    """One concealed effect.

    Attributes:
        id: as in the product.
        joint: number of its joint, or of its link's; -1 for all of the robot.
        shape: parameters that the torque is not proportional to.
        strength: its size, in the units of its first parameter.
        window: (start, end) [s], for good if None.
    """

    id: str
    joint: int
    shape: Shape = field(default_factory=dict)
    strength: float = 1.0
    window: tuple[float, float] | None = None

    def of(self, strength: float) -> Effect:
        """Return the same, stronger or weaker."""
        return replace(self, strength=float(strength))


def _time_varying(x: Any, j: int, s: Shape) -> Any:
    return s["end"] + (1 - s["end"]) * np.exp(-x.t / s["time"])


def _region(x: Any, j: int, s: Shape) -> Any:
    far = (x.q[..., j] - s["centre"]) / s["width"]
    return np.exp(-(far**2)) if s["soft"] else 1 / (1 + np.abs(far) ** 12)


DRY: Mapping[str, Callable[[Any, int, Shape], Any]] = {
    "stribeck_friction": lambda x, j, s: np.exp(-((x.v[..., j] / s["speed"]) ** 2)),
    "load_dependent_friction": lambda x, j, s: np.abs(x.load[..., j]),
    "quadratic_drag": lambda x, j, s: x.v[..., j] ** 2,
    "time_varying_friction": _time_varying,
    "position_dependent_friction": _region,
}
"""Levels >= 0 that act against the motion."""
PUSH: Mapping[str, Callable[[Any, int, Shape], Any]] = {
    "joint_spring": lambda x, j, s: x.q[..., j] - s["rest"],
    "one_sided_spring": lambda x, j, s: s["side"] * np.maximum(0.0, s["side"] * (x.q[..., j] - s["contact"])),
    "torque_ripple": lambda x, j, s: np.sin(s["order"] * x.q[..., j] + s["phase"]),
    "joint_coupling": lambda x, j, s: s["sign"] * (x.q[..., int(s["other"])] - s["rest"]),
}
"""Torques of positions."""


def dahl(z: float, moved: float, distance: float) -> float:
    """Return Dahl's state, in [-1, 1], after a step [rad]: dz/dq = (1 - z sign(dq)) / distance, exactly."""
    end = np.copysign(1.0, moved)
    return float(end + (z - end) * np.exp(-abs(moved) / distance))


def dahl_along(q: np.ndarray, distance: float) -> np.ndarray:
    """Return Dahl's state along positions (N,); it starts at 0."""
    z = [0.0]
    for moved in np.diff(q).tolist():
        z.append(dahl(z[-1], moved, distance))
    return np.array(z)


def late(t: np.ndarray, x: np.ndarray, delay: float) -> np.ndarray:
    """Return x (N,) later by a delay [s]."""
    return np.interp(t - delay, t, x)


def joint_torque(effect: Effect, x: Motion) -> np.ndarray | None:
    """Return what an effect at one joint adds along a motion, (N, n); None for effects of links and the whole robot."""
    j, s = effect.joint, effect.shape
    if effect.id in DRY:
        torque = DRY[effect.id](x, j, s) * x.direction[:, j]
    elif effect.id in PUSH:
        torque = PUSH[effect.id](x, j, s)
    elif effect.id == "presliding_hysteresis":
        torque = dahl_along(x.q[:, j], s["distance"])
    elif effect.id == "rotor_inertia":
        torque = x.a[:, j]
    elif effect.id == "torque_offset":
        torque = np.full(len(x.t), s["sign"])
    elif effect.id == "torque_scale":
        torque = s["sign"] * x.supplied[:, j]
    else:
        return None
    tau = np.zeros_like(x.q)
    tau[:, j] = effect.strength * torque
    return tau


def parameters(effect: Effect, coulomb: float) -> dict[str, float]:
    """Return an effect's parameters as the product names them, for effects at one joint.

    Args:
        effect: one of this file's.
        coulomb: friction that the joint has anyway; levels of friction count it.
    """
    k, s = effect.strength, effect.shape
    return {
        "stribeck_friction": lambda: {"coulomb": coulomb, "static": coulomb + k, "stribeck_speed": s["speed"]},
        "load_dependent_friction": lambda: {"load_friction": k},
        "quadratic_drag": lambda: {"drag": k},
        "time_varying_friction": lambda: {
            "coulomb_end": coulomb + k * s["end"], "coulomb_start": coulomb + k, "time_constant": s["time"],
        },
        "position_dependent_friction": lambda: {
            "centre": s["centre"], "width": s["width"], "coulomb": coulomb, "coulomb_at_centre": coulomb + k,
        },
        "joint_spring": lambda: {"stiffness": k, "rest_position": s["rest"]},
        "one_sided_spring": lambda: {"stiffness": k, "contact_position": s["contact"], "side": s["side"]},
        "torque_ripple": lambda: {"amplitude": k, "phase": s["phase"], "order": s["order"]},
        "joint_coupling": lambda: {"stiffness": s["sign"] * k, "offset": -s["sign"] * k * s["rest"]},
        "presliding_hysteresis": lambda: {"coulomb": k, "distance": s["distance"]},
        "rotor_inertia": lambda: {"rotor_inertia": k},
        "torque_offset": lambda: {"offset": s["sign"] * k},
        "torque_scale": lambda: {"gain": 1.0 + s["sign"] * k},
        "time_delay": lambda: {"delay": s["sign"] * k},
        "actuator_lag": lambda: {"time_constant": k},
        "encoder_offset": lambda: {"offset": s["sign"] * k},
    }[effect.id]()  # fmt: skip
