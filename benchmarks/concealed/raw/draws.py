"""Draw concealed effects: places, and shapes that are plausible for a motion."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from ..robots import Robot
from .laws import Effect, Motion

LARGEST: Mapping[str, float] = {
    "load_dependent_friction": 0.6,
    "torque_scale": 0.5,
    "time_delay": 0.03,
    "actuator_lag": 0.04,
    "encoder_offset": 0.08,
    "base_tilt": 0.1,
}
"""The largest plausible strengths; those of geometry and payload depend on the arm."""


def _side(rng: np.random.Generator) -> float:
    return float(rng.choice([-1.0, 1.0]))


def _unit(rng: np.random.Generator, n: int) -> np.ndarray:
    d = rng.standard_normal(n)
    return d / np.linalg.norm(d)


def _within(rng: np.random.Generator, q: np.ndarray, low: float, high: float) -> float:
    return float(np.quantile(q, rng.uniform(low, high)))


def _stribeck(rng: np.random.Generator, x: Motion, j: int) -> dict[str, float]:
    return {"speed": float(rng.uniform(0.06, 0.3) * np.quantile(np.abs(x.v[:, j]), 0.95))}


def _contact(rng: np.random.Generator, x: Motion, j: int) -> dict[str, float]:
    side = _side(rng)
    return {"side": side, "contact": side * _within(rng, side * x.q[:, j], 0.55, 0.85)}


def _ripple(rng: np.random.Generator, x: Motion, j: int) -> dict[str, float]:
    # At least three periods in the range, and below 12 Hz at the speeds that are usual.
    least = 3 * 2 * np.pi / np.ptp(x.q[:, j])
    most = 2 * np.pi * 12.0 / (np.quantile(np.abs(x.v[:, j]), 0.9) + 1e-6)
    order = np.exp(rng.uniform(np.log(least), np.log(np.clip(most, 1.5 * least, 100.0 + least))))
    return {"order": float(np.ceil(order)), "phase": float(rng.uniform(-np.pi, np.pi))}


def _coupling(rng: np.random.Generator, x: Motion, j: int) -> dict[str, float]:
    other = int(rng.choice([k for k in range(x.q.shape[1]) if k != j]))
    return {"other": float(other), "rest": float(x.q[:, other].mean()), "sign": _side(rng)}


def _region(rng: np.random.Generator, x: Motion, j: int) -> dict[str, float]:
    width = float(rng.uniform(0.08, 0.22) * np.ptp(x.q[:, j]))
    return {"centre": _within(rng, x.q[:, j], 0.15, 0.85), "width": width, "soft": float(rng.random() < 0.6)}


SHAPES: Mapping[str, Callable[[np.random.Generator, Motion, int], dict[str, float]]] = {
    "stribeck_friction": _stribeck,
    "load_dependent_friction": lambda rng, x, j: {},
    "quadratic_drag": lambda rng, x, j: {},
    "time_varying_friction": lambda rng, x, j: {
        "end": float(rng.uniform(0.0, 0.3)), "time": float(rng.uniform(4.0, 14.0)),
    },
    "position_dependent_friction": _region,
    "presliding_hysteresis": lambda rng, x, j: {"distance": float(rng.uniform(0.02, 0.1) * np.ptp(x.q[:, j]))},
    "rotor_inertia": lambda rng, x, j: {},
    "joint_spring": lambda rng, x, j: {"rest": _within(rng, x.q[:, j], 0.1, 0.9)},
    "one_sided_spring": _contact,
    "torque_ripple": _ripple,
    "joint_coupling": _coupling,
    "torque_offset": lambda rng, x, j: {"sign": _side(rng)},
    "torque_scale": lambda rng, x, j: {"sign": _side(rng)},
    "time_delay": lambda rng, x, j: {"sign": float(rng.choice([1.0, 1.0, -1.0]))},
    "actuator_lag": lambda rng, x, j: {},
    "encoder_offset": lambda rng, x, j: {"sign": _side(rng)},
    "base_tilt": lambda rng, x, j: dict(zip(("x", "y", "z"), (*_unit(rng, 2).tolist(), 0.0), strict=True)),
    "geometry_error": lambda rng, x, j: {},
    "external_wrench": lambda rng, x, j: dict(
        zip(("x", "y", "z", "rx", "ry", "rz"), (*_unit(rng, 3), *(0.15 * _unit(rng, 3))), strict=True)
    ),
    "payload": lambda rng, x, j: {},
}  # fmt: skip
KINDS = tuple(SHAPES)
NULLS = 4
"""Cases without an effect for each round of KINDS."""
WHOLE = ("base_tilt", "geometry_error", "encoder_offset", "external_wrench", "payload", "time_delay", "actuator_lag")
"""Effects whose size is that of the joint where it is largest."""


def draw_effect(rng: np.random.Generator, kind: str, robot: Robot, x: Motion) -> Effect:
    """Draw an effect of unit strength for the motion along which it is to be seen."""
    n, j = robot.n, int(rng.integers(robot.n))
    shape, window = {k: float(v) for k, v in SHAPES[kind](rng, x, j).items()}, None
    if kind == "base_tilt" or (kind in ("time_delay", "actuator_lag") and rng.random() < 0.5):
        j = -1
    elif kind == "encoder_offset":
        j = int(rng.integers(1, n))
    elif kind == "geometry_error":
        # Shifting or turning the first joint is moving the base.
        j = int(rng.integers(1, n))
        moved = _unit(rng, 3).tolist()
        shift = rng.random() < 0.5
        shape = dict(zip(("x", "y", "z", "rx", "ry", "rz"), [*moved, 0, 0, 0] if shift else [0, 0, 0, *moved],
                         strict=True))  # fmt: skip
    elif kind in ("external_wrench", "payload"):
        j = int(rng.integers(n // 2, n))
        seconds = float(x.t[-1])
        start = float(rng.uniform(0.15, 0.6)) * seconds
        window = (start, float("inf") if kind == "payload" else start + float(rng.uniform(0.07, 0.3)) * seconds)
        if kind == "payload":
            body = robot.model.inertias[j + 1]
            radius = float(rng.uniform(0.02, 0.06))
            centre = body.lever + (0.05 + np.linalg.norm(body.lever)) * rng.uniform(-0.8, 0.8, 3)
            shape = {"radius": radius, **dict(zip(("x", "y", "z"), centre.tolist(), strict=True))}
    return Effect(kind, j, shape, 1.0, window)


def largest(effect: Effect, robot: Robot) -> float:
    """Return the largest plausible strength."""
    if effect.id == "geometry_error":
        return 0.15 if effect.shape["rx"] else 0.05
    if effect.id == "payload":
        return 0.3 + 1.5 * sum(body.mass for body in list(robot.model.inertias)[effect.joint + 1 :])
    return LARGEST.get(effect.id, float("inf"))


def small(effect: Effect, robot: Robot) -> float:
    """Return a strength to start from when it is brought to its size."""
    limit = largest(effect, robot)
    return 1.0 if np.isinf(limit) else 0.3 * limit
