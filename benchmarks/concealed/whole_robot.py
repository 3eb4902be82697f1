"""Effects of bodies and of the world: rotor inertia, payloads, wrenches, a tilted base, wrong geometry.

Pinocchio's changed model tells the torque; MuJoCo's changed model moves.
"""

# pyright: reportAttributeAccessIssue=false
# (MuJoCo ships no type stubs)

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin

from .contract import Effect, Now, Place, named
from .motion import Motion
from .robots import Robot


@dataclass
class RotorInertia(Effect):
    """I qdd at one joint."""

    id = "rotor_inertia"

    @classmethod
    def draw(cls, rng: np.random.Generator, x: Motion, joint: int) -> RotorInertia:
        return cls(joint, 1.0)

    def torque(self, x: Motion) -> np.ndarray:
        return self.at_joint(x, self.strength * x.qdd[:, self.joint])

    def change(self, model: mujoco.MjModel) -> None:
        model.dof_armature[self.joint] += self.strength

    def parameters(self, x: Motion) -> dict[str, float]:
        return {"rotor_inertia": self.strength}

    def depends_on(self, robot: Robot) -> list[str]:
        return [f"qdd_{robot.joints[self.joint]}"]


@dataclass
class Changed(Effect):
    """The torque of a changed model less that of the URDF's; ``direction`` times strength is the change."""

    whole_robot = True
    direction: np.ndarray

    @abstractmethod
    def changed(self, model: pin.Model) -> pin.Model:
        """Return a changed copy."""

    def torque(self, x: Motion) -> np.ndarray:
        tau, rows = np.zeros_like(x.load), self._rows(x)
        if rows.any():
            model = self.changed(x.robot.model.copy())
            tau[rows] = x.robot.torque(x.q[rows], x.qd[rows], x.qdd[rows], model) - x.load[rows]
        return tau

    def _rows(self, x: Motion) -> np.ndarray:
        return np.ones(len(x.t), bool) if self.window is None else self.window.holds(x)

    def place(self, robot: Robot) -> Place:
        return {"joints": [], "links": [robot.links[self.joint]], "other": None, "region": None}

    def depends_on(self, robot: Robot) -> list[str]:
        return [f"q_{joint}" for joint in robot.joints]


@dataclass
class Payload(Changed):
    """A body of mass ``strength`` on the link that ``joint`` moves, its centre at ``direction`` in the link's frame."""

    id = "payload"

    @classmethod
    def draw(cls, rng: np.random.Generator, x: Motion, joint: int) -> Payload:
        body = x.robot.model.inertias[joint + 1]
        reach = float(np.linalg.norm(body.lever)) + 0.05
        return cls(joint, 1.0, body.lever + reach * rng.uniform(-1, 1, 3))

    def _body(self) -> pin.Inertia:
        """Return a small ball."""
        return pin.Inertia.FromSphere(self.strength, 0.03)

    def changed(self, model: pin.Model) -> pin.Model:
        model.appendBodyToJoint(self.joint + 1, self._body(), pin.SE3(np.eye(3), self.direction))
        return model

    def change(self, model: mujoco.MjModel) -> None:
        k, m, ball = model.jnt_bodyid[self.joint], self.strength, 0.4 * self.strength * 0.03**2
        rotation = np.empty(9)
        mujoco.mju_quat2Mat(rotation, model.body_iquat[k])
        R, mass, centre = rotation.reshape(3, 3), float(model.body_mass[k]), model.body_ipos[k].copy()
        total = mass + m
        middle = (mass * centre + m * self.direction) / total
        moments = R @ np.diag(model.body_inertia[k]) @ R.T + ball * np.eye(3)
        for part, at in ((mass, centre), (m, self.direction)):
            arm = at - middle
            moments += part * (arm @ arm * np.eye(3) - np.outer(arm, arm))
        values, axes = np.linalg.eigh(moments)
        axes = axes * np.sign(np.linalg.det(axes))
        model.body_mass[k], model.body_ipos[k], model.body_inertia[k] = total, middle, values
        mujoco.mju_mat2Quat(model.body_iquat[k], axes.ravel())
        mujoco.mj_setConst(model, mujoco.MjData(model))

    def limit(self, x: Motion) -> float:
        # As heavy as all links that it hangs on from its own outwards, and a little more.
        return 0.2 + 1.5 * sum(body.mass for body in list(x.robot.model.inertias)[self.joint + 1 :])

    def parameters(self, x: Motion) -> dict[str, float]:
        return {"mass": self.strength, **dict(zip("xyz", self.direction.tolist(), strict=True))}


@dataclass
class ExternalWrench(Changed):
    """A force and moment, strength times ``direction`` (6,), on a link at its origin, in world axes."""

    id = "external_wrench"

    @classmethod
    def draw(cls, rng: np.random.Generator, x: Motion, joint: int) -> ExternalWrench:
        force, moment = rng.standard_normal(3), 0.1 * rng.standard_normal(3)
        return cls(joint, 1.0, np.array([*force, *moment]))

    def changed(self, model: pin.Model) -> pin.Model:
        return model

    def torque(self, x: Motion) -> np.ndarray:
        model, rows, wrench = x.robot.model, self._rows(x), self.strength * self.direction
        data, tau = model.createData(), np.zeros_like(x.load)
        for k in np.flatnonzero(rows):
            frame = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
            J = pin.computeJointJacobians(model, data, x.q[k])
            J = pin.getJointJacobian(model, data, self.joint + 1, frame)
            tau[k] = -J.T @ wrench
        return tau

    def act(self, now: Now) -> None:
        inside = self.window is None or self.window.holds(now)
        # MuJoCo's is a force at the centre of mass: the moment is moved there.
        applied = now.applied[self.joint]
        applied[:] = 0.0
        if inside:
            force, moment = self.strength * self.direction[:3], self.strength * self.direction[3:]
            applied[:3], applied[3:] = force, moment + np.cross(now.origin[self.joint] - now.centre[self.joint], force)

    def parameters(self, x: Motion) -> dict[str, float]:
        names = [f"{kind}_{axis}" for kind in ("force", "moment") for axis in "xyz"]
        return dict(zip(names, (self.strength * self.direction).tolist(), strict=True))


@dataclass
class BaseTilt(Changed):
    """The base is turned by strength times (direction_x, direction_y, 0) [rad]."""

    id = "base_tilt"

    @classmethod
    def draw(cls, rng: np.random.Generator, x: Motion, joint: int) -> BaseTilt:
        angle = rng.uniform(-np.pi, np.pi)
        return cls(-1, 0.02, np.array([np.cos(angle), np.sin(angle), 0.0]))

    def _gravity(self, gravity: np.ndarray) -> np.ndarray:
        return pin.exp3(-self.strength * self.direction) @ gravity

    def changed(self, model: pin.Model) -> pin.Model:
        model.gravity = pin.Motion(self._gravity(model.gravity.linear), np.zeros(3))
        return model

    def change(self, model: mujoco.MjModel) -> None:
        model.opt.gravity = self._gravity(model.opt.gravity)

    def limit(self, x: Motion) -> float:
        return 0.2

    def parameters(self, x: Motion) -> dict[str, float]:
        tilt = (self.strength * self.direction).tolist()
        return {"tilt_x": tilt[0], "tilt_y": tilt[1]}

    def place(self, robot: Robot) -> Place:
        return {"joints": [], "links": [], "other": None, "region": None}

    def same_as(self, robot: Robot) -> list[Any]:
        return [named("geometry_error", robot, [0])]


@dataclass
class GeometryError(Changed):
    """A joint's origin is shifted [m] or turned [rad] by strength times ``direction`` (6,), in the parent's frame."""

    id = "geometry_error"

    @classmethod
    def draw(cls, rng: np.random.Generator, x: Motion, joint: int) -> GeometryError:
        direction = rng.standard_normal(3)
        shift = rng.random() < 0.5
        direction /= np.linalg.norm(direction)
        return cls(joint, 0.01, np.array([*direction, 0, 0, 0] if shift else [0, 0, 0, *direction]))

    def changed(self, model: pin.Model) -> pin.Model:
        placement, change = model.jointPlacements[self.joint + 1], self.strength * self.direction
        turned = pin.exp3(change[3:]) @ placement.rotation
        model.jointPlacements[self.joint + 1] = pin.SE3(turned, placement.translation + change[:3])
        return model

    def change(self, model: mujoco.MjModel) -> None:
        k, change = model.jnt_bodyid[self.joint], self.strength * self.direction
        model.body_pos[k] += change[:3]
        angle = float(np.linalg.norm(change[3:]))
        if angle:
            turn, turned = np.empty(4), np.empty(4)
            mujoco.mju_axisAngle2Quat(turn, change[3:] / angle, angle)
            mujoco.mju_mulQuat(turned, turn, model.body_quat[k])
            model.body_quat[k] = turned
        mujoco.mj_setConst(model, mujoco.MjData(model))

    def limit(self, x: Motion) -> float:
        return 0.06 if self.direction[:3].any() else 0.2

    def parameters(self, x: Motion) -> dict[str, float]:
        names = ("x", "y", "z", "rx", "ry", "rz")
        return dict(zip(names, (self.strength * self.direction).tolist(), strict=True))

    def place(self, robot: Robot) -> Place:
        return {"joints": [robot.joints[self.joint]], "links": [], "other": None, "region": None}

    def same_as(self, robot: Robot) -> list[Any]:
        turned = [named("encoder_offset", robot, [self.joint])] if self.direction[3:].any() else []
        return turned + ([named("base_tilt", robot)] if self.joint == 0 else [])
