"""What a recording cannot tell apart: how far other names explain an effect's torque beside rigid body and friction.

The base is a regression of all inertial parameters, viscous friction and Coulomb friction of both directions at every
joint, rows in parts of their joint's torque. What is left of the effect's torque beside it is what can be seen at all;
a candidate whose own columns, beside the base, explain most of that is as right a name.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.signal import lfilter

from ..robots import Robot
from . import bodies
from .laws import DRY, PUSH, Effect, Motion, dahl_along
from .sensing import NOISE, RATE_HZ

SHARE = 0.9
"""Of what is left of the truth, as much as another name has to explain to be as right."""
_HIDDEN, _MOST = 1e-7, 1.0  # power beside the base, in parts of a column's own; power in parts of the joints' torque
_DELAYS_S = (-0.012, 0.012)
_TURN = 1e-4
_OF_ALL = ("torque_scale", "time_delay", "actuator_lag")


@dataclass(frozen=True)
class Seen:
    """What a recording can say of an effect.

    Attributes:
        remains: part of its torque's power that is left beside the base.
        left: (n,) RMS of that in parts of the joints' torque.
        nats: log likelihood that it is worth beside the base, torque noise being the only one.
        same: [{"effect", "joints", "links", "explains"}] of other names, the best first.
    """

    remains: float
    left: np.ndarray
    nats: float
    same: list[dict[str, Any]]


@dataclass(frozen=True)
class Candidate:
    """Columns of another name: (N, K) at one joint's rows, or (N, n, K) of all."""

    effect: str
    joints: tuple[int, ...]
    links: tuple[int, ...]
    columns: np.ndarray
    row: int | None = None
    other: int | None = None


def look(robot: Robot, x: Motion, tau: np.ndarray, size: np.ndarray, colour_s: np.ndarray, effect: Effect) -> Seen:
    """Say what can be seen of an effect.

    Args:
        robot: with the geometry that is told.
        x: motion as it is recorded, without noise; supplied is what torque is supplied to body and friction.
        tau: (N, n) the effect's torque.
        size: (n,) by which rows are divided [N m].
        colour_s: (n,) of the torque noise.
        effect: to be seen.
    """
    n, count = robot.n, len(x.t)
    base = np.concatenate([robot.regressor(x.q, x.v, x.a), _friction(x)], axis=2)
    e = tau / size
    Q = _basis((base / size[:, None]).reshape(count * n, -1)).reshape(count, n, -1)
    r = e - Q @ np.einsum("kip,ki->p", Q, e)
    power = float(np.sum(r**2))
    found: dict[tuple[Any, ...], dict[str, Any]] = {}
    for c in candidates(robot, x, effect) if power > 0 else ():
        explains = _explained(Q, r, c, size) / power
        if explains < SHARE or (c.effect == effect.id and _place(effect) == (c.joints, c.links, c.other)):
            continue
        entry = _entry(robot, c, explains)
        key = c.effect, c.joints, c.links, c.other
        if key not in found or found[key]["explains"] < explains:
            found[key] = entry
    same = sorted(found.values(), key=lambda f: -f["explains"])
    nats = _nats(base / size[:, None], e, colour_s)
    return Seen(power / float(np.sum(e**2)), np.sqrt(np.mean(r**2, axis=0)), nats, same)


def _place(effect: Effect) -> tuple[tuple[int, ...], tuple[int, ...], int | None]:
    """Return joints, links and the other joint, as a candidate has them."""
    if effect.id in ("payload", "external_wrench"):
        return (), (effect.joint,), None
    other = int(effect.shape["other"]) if "other" in effect.shape else None
    return ((effect.joint,) if effect.joint >= 0 else ()), (), other


def _entry(robot: Robot, c: Candidate, explains: float) -> dict[str, Any]:
    # Alike at all joints, which is another place than none.
    joints = range(robot.n) if c.effect in _OF_ALL and not c.joints else c.joints
    names = {"joints": [robot.joints[j] for j in joints], "links": [robot.links[k] for k in c.links]}
    other = {} if c.other is None else {"other": robot.joints[c.other]}
    return {"effect": c.effect, **names, **other, "explains": round(explains, 4)}


def _friction(x: Motion) -> np.ndarray:
    """Return viscous and two Coulomb columns of each joint, (N, n, 3 n)."""
    eye = np.eye(x.q.shape[1])
    parts = x.v, np.maximum(x.direction, 0), np.minimum(x.direction, 0)
    return np.concatenate([eye * part[:, None] for part in parts], axis=2)


def _basis(A: np.ndarray) -> np.ndarray:
    """Return an orthonormal basis of the columns' span, (rows, rank)."""
    scale = np.linalg.norm(A, axis=0)
    A = A[:, scale > 1e-9 * scale.max()]
    A = A / np.linalg.norm(A, axis=0)
    values, vectors = np.linalg.eigh(A.T @ A)
    kept = values > 1e-10 * values[-1]
    return A @ (vectors[:, kept] / np.sqrt(values[kept]))


def _explained(Q: np.ndarray, r: np.ndarray, c: Candidate, size: np.ndarray) -> float:
    """Return how much of r'r a candidate's columns explain, given the base."""
    if c.row is not None:
        C, rows, left = c.columns / size[c.row], Q[:, c.row], r[:, c.row]
    else:
        C = (c.columns / size[:, None]).reshape(-1, c.columns.shape[-1])
        rows, left = Q.reshape(len(C), -1), r.ravel()
    C = C / np.maximum(np.linalg.norm(C, axis=0), 1e-300)
    P = rows.T @ C
    values, vectors = np.linalg.eigh(C.T @ C - P.T @ P)
    kept = values > _HIDDEN
    towards = vectors[:, kept].T @ (C.T @ left)
    needed = C @ (vectors[:, kept] @ (towards / values[kept]))
    if needed @ needed > _MOST * len(needed):
        # All of it but a trace would be hidden by other inertials: nobody takes that for an explanation.
        return 0.0
    return float(np.sum(towards**2 / values[kept]))


def _nats(base: np.ndarray, e: np.ndarray, colour_s: np.ndarray) -> float:
    """Return half the power of what is left, whitened by the torque noise."""
    white = []
    for j, pole in enumerate(np.exp(-1 / (RATE_HZ * colour_s))):
        both = np.concatenate([base[:, j], e[:, j, None]], axis=1)
        white.append(lfilter([1, -pole], [1], both, axis=0)[1:] / (NOISE * np.sqrt(1 - pole**2)))
    white = np.concatenate(white)
    Q = _basis(white[:, :-1])
    left = white[:, -1] - Q @ (Q.T @ white[:, -1])
    return 0.5 * float(left @ left)


def candidates(robot: Robot, x: Motion, effect: Effect) -> Iterator[Candidate]:
    """Yield all names and places, on grids of shapes, in the window of the effect if it has one."""
    n, inside = robot.n, bodies.inside(effect, x.t)
    for j in range(n):
        yield from _of_joint(x, j, inside)
    yield Candidate("torque_scale", (), (), x.supplied[:, :, None])
    for delay in _DELAYS_S:
        yield Candidate("time_delay", (), (), _later(x, delay)[:, :, None])
    yield Candidate("actuator_lag", (), (), np.gradient(x.supplied, x.t, axis=0)[:, :, None])
    tilts = [Effect("base_tilt", -1, {"x": a, "y": 1 - a, "z": 0.0}, _TURN) for a in (0.0, 1.0)]
    yield Candidate("base_tilt", (), (), _slopes(robot, tilts, x))
    for j in range(n):
        offset = Effect("encoder_offset", j, {"sign": 1.0}, _TURN)
        yield Candidate("encoder_offset", (j,), (), _slopes(robot, [offset], x))
        if j:
            keys = "x", "y", "z", "rx", "ry", "rz"
            moves = [Effect("geometry_error", j, dict(zip(keys, d, strict=True)), _TURN) for d in np.eye(6).tolist()]
            yield Candidate("geometry_error", (j,), (), _slopes(robot, moves, x))
    if not inside.all():
        Y = robot.regressor(x.q, x.v, x.a) * inside[:, None, None]
        for j in range(n):
            wrench = bodies.wrench_torque(robot, x.q, j, np.eye(6)) * inside[:, None, None]
            yield Candidate("external_wrench", (), (j,), wrench)
            yield Candidate("payload", (), (j,), Y[:, :, 10 * j : 10 * j + 10])


def _later(x: Motion, delay: float) -> np.ndarray:
    return np.stack([np.interp(x.t - delay, x.t, column) - column for column in x.supplied.T], axis=1)


def _slopes(robot: Robot, effects: list[Effect], x: Motion) -> np.ndarray:
    """Return torques of small effects per unit, (N, n, K)."""
    return np.stack([bodies.torque(robot, effect, x) / effect.strength for effect in effects], axis=2)


def _of_joint(x: Motion, j: int, inside: np.ndarray) -> Iterator[Candidate]:
    """Yield the names of one joint."""
    q, v = x.q[:, j], x.v[:, j]
    low, span, fast = q.min(), np.ptp(q), float(np.quantile(np.abs(v), 0.95))

    def one(effect: str, *columns: np.ndarray, other: int | None = None) -> Candidate:
        return Candidate(effect, (j,), (), np.stack(columns, axis=1), j, other)

    def dry(effect: str, **shape: float) -> Candidate:
        return one(effect, DRY[effect](x, j, shape) * x.direction[:, j])

    yield from (dry("stribeck_friction", speed=s * fast) for s in (0.03, 0.06, 0.1, 0.16, 0.25, 0.4))
    yield dry("load_dependent_friction")
    yield dry("quadratic_drag")
    yield from (one("power_law_friction", np.abs(v) ** p * x.direction[:, j]) for p in (0.5, 1.5, 2.0))
    yield from (dry("time_varying_friction", end=0.0, time=s) for s in (3.0, 6.0, 12.0, 25.0))
    for centre in np.linspace(0.05, 0.95, 13):
        for width in (0.06, 0.12, 0.2, 0.3):
            for soft in (1.0, 0.0):
                place = {"centre": low + centre * span, "width": width * span, "soft": soft}
                yield dry("position_dependent_friction", **place)
    yield from (one("presliding_hysteresis", dahl_along(q, s * span)) for s in (0.01, 0.02, 0.04, 0.08, 0.15))
    yield one("rotor_inertia", x.a[:, j])
    yield one("joint_spring", q - q.mean())
    for contact in np.linspace(0.1, 0.9, 13):
        for side in (-1.0, 1.0):
            yield one(
                "one_sided_spring", PUSH["one_sided_spring"](x, j, {"side": side, "contact": low + contact * span})
            )
    for order in np.arange(3 * np.pi / span, 60.0, np.pi / span / 2) if span > 0.2 else ():
        yield one("torque_ripple", np.sin(order * q), np.cos(order * q))
    for k in range(x.q.shape[1]):
        if k != j:
            yield one("joint_coupling", x.q[:, k] - x.q[:, k].mean(), other=k)
            yield one("velocity_coupling", x.v[:, k], other=k)
    yield one("torque_offset", np.ones_like(q))
    yield one("torque_scale", x.supplied[:, j])
    yield one("actuator_lag", np.gradient(x.supplied[:, j], x.t))
    yield from (one("time_delay", _later(x, delay)[:, j]) for delay in _DELAYS_S)
    if not inside.all():
        yield one("torque_offset", inside.astype(float))
