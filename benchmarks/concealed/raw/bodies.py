"""Concealed effects of links and of the whole robot: the torque that they add, by Pinocchio, and changed robots."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ..robots import Robot
from ..urdf import urdf_of
from .laws import Effect, Motion, joint_torque, late

AXES = "xyz"
CHANGED = ("payload", "base_tilt", "geometry_error")
"""Effects that are another robot."""


def direction(effect: Effect) -> np.ndarray:
    """Return the six numbers of a wrench or of a shift and turn, or three of a centre or of a tilt."""
    return np.array([effect.shape[k] for k in (*AXES, "rx", "ry", "rz") if k in effect.shape])


def changed(robot: Robot, effect: Effect) -> pin.Model:
    """Return the robot with a payload, a tilted base or another geometry."""
    model, k, d = robot.model.copy(), effect.joint + 1, effect.strength * direction(effect)
    if effect.id == "payload":
        ball = pin.Inertia.FromSphere(effect.strength, effect.shape["radius"])
        model.inertias[k] = model.inertias[k] + pin.SE3(np.eye(3), direction(effect)).act(ball)
    elif effect.id == "base_tilt":
        model.gravity = pin.Motion(pin.exp3(-d) @ model.gravity.linear, np.zeros(3))
    elif effect.id == "geometry_error":
        place = model.jointPlacements[k]
        model.jointPlacements[k] = pin.SE3(pin.exp3(d[3:]) @ place.rotation, place.translation + d[:3])
    return model


def changed_urdf(robot: Robot, effect: Effect | None) -> tuple[str, np.ndarray]:
    """Return the text of the robot with an effect of bodies, and its gravity."""
    model = robot.model if effect is None or effect.id not in CHANGED else changed(robot, effect)
    return urdf_of(model), np.array(model.gravity.linear)


def wrench_torque(robot: Robot, q: np.ndarray, joint: int, wrench: np.ndarray) -> np.ndarray:
    """Return -J' w (N, n) of wrenches (6, ...) on a link at its origin in world axes; (N, n, ...)."""
    data, model, rows = robot.model.createData(), robot.model, []
    for row in q:
        pin.computeJointJacobians(model, data, row)
        rows.append(-pin.getJointJacobian(model, data, joint + 1, pin.LOCAL_WORLD_ALIGNED).T @ wrench)
    return np.array(rows)


def inside(effect: Effect, t: np.ndarray) -> np.ndarray:
    """Return whether an effect acts, (N,)."""
    if effect.window is None:
        return np.ones(len(t), bool)
    return (t >= effect.window[0]) & (t < effect.window[1])


def torque(robot: Robot, effect: Effect, x: Motion) -> np.ndarray:
    """Return what an effect adds to the recorded torque of the recorded motion, (N, n)."""
    own = joint_torque(effect, x)
    if own is not None:
        return own
    rows = inside(effect, x.t)
    tau = np.zeros_like(x.q)
    if effect.id in CHANGED:
        q, v, a = x.q[rows], x.v[rows], x.a[rows]
        tau[rows] = robot.torque(q, v, a, changed(robot, effect)) - robot.torque(q, v, a)
    elif effect.id == "external_wrench":
        tau[rows] = wrench_torque(robot, x.q[rows], effect.joint, effect.strength * direction(effect))
    elif effect.id == "encoder_offset":
        told = x.q.copy()
        told[:, effect.joint] += effect.shape["sign"] * effect.strength
        tau = robot.torque(x.q, x.v, x.a) - robot.torque(told, x.v, x.a)
    elif effect.id in ("time_delay", "actuator_lag"):
        joints = range(robot.n) if effect.joint < 0 else [effect.joint]
        for j in joints:
            if effect.id == "actuator_lag":
                tau[:, j] = effect.strength * np.gradient(x.supplied[:, j], x.t)
            else:
                tau[:, j] = late(x.t, x.supplied[:, j], effect.shape["sign"] * effect.strength) - x.supplied[:, j]
    else:
        raise ValueError(f"no effect is called '{effect.id}'")
    return tau


def parameters(effect: Effect) -> dict[str, float]:
    """Return the parameters of effects that ``laws.parameters`` does not know, as the product names them."""
    d = effect.strength * direction(effect)
    if effect.id == "payload":
        return {"mass": effect.strength, **dict(zip(AXES, direction(effect).tolist(), strict=True))}
    names = {
        "base_tilt": ("tilt_x", "tilt_y"),
        "geometry_error": (*AXES, "rx", "ry", "rz"),
        "external_wrench": tuple(f"{kind}_{axis}" for kind in ("force", "moment") for axis in AXES),
    }[effect.id]
    return dict(zip(names, d.tolist(), strict=False))
