"""Robots of the concealed benchmark: arms of public URDFs and random arms; development and final set share none.

A robot here is the true one. Dynamics for sizes and feed-forward are Pinocchio's; motion is MuJoCo's (simulate.py).
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cached_property
from importlib import metadata
from pathlib import Path

import numpy as np
import pinocchio as pin

from .urdf import urdf_of, with_wrong_inertials

SETS = ("development", "final")
# File below example-robot-data's robots/ and the joints that stay; all others are locked and merged into their links.
PUBLIC = {
    "development": {
        "ur10": ("ur_description/urdf/ur10_robot.urdf", r".*"),
        "kinova": ("kinova_description/robots/kinova.urdf", r".*"),
        "pr2": ("pr2_description/urdf/pr2.urdf", r"l_(shoulder|upper_arm|elbow|forearm|wrist)_.*"),
        "talos": ("talos_data/robots/talos_left_arm.urdf", r"arm_left_\d_joint"),
    },
    "final": {
        "panda": ("panda_description/urdf/panda.urdf", r"panda_joint\d"),
        "xarm7": ("xarm_description/urdf/xarm7.urdf", r".*"),
        "baxter": ("baxter_description/urdf/baxter.urdf", r"left_[sew]\d"),
        "ur5": ("ur_description/urdf/ur5_robot.urdf", r".*"),
        "z1": ("z1_description/urdf/z1.urdf", r"joint\d"),
    },
}
_REACH, _SPEED = 2.5, 2.5  # rad, rad/s: what motions use of a joint that allows more


@dataclass(frozen=True)
class Robot:
    """A serial arm of revolute joints; link k is moved by joint k and its frame is the joint's.

    Attributes:
        name: of the kind of arm.
        urdf: text.
    """

    name: str
    urdf: str

    @cached_property
    def model(self) -> pin.Model:
        """Pinocchio's model."""
        return pin.buildModelFromXML(self.urdf)

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.model.nv

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints, from the base."""
        return tuple(self.model.names)[1:]

    @property
    def links(self) -> tuple[str, ...]:
        """Names of the links that the joints move."""
        return tuple(f"{joint}_link" for joint in self.joints)

    def range(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the lowest and highest position [rad] and the highest speed [rad/s] of motions, (n,) each."""
        low, high = self.model.lowerPositionLimit, self.model.upperPositionLimit
        # A joint that may turn on and on is used around 0.
        low, high = (
            np.maximum(low, np.minimum(high, _REACH) - 2 * _REACH),
            np.minimum(high, np.maximum(low, 0) + _REACH),
        )
        return low, high, np.minimum(self.model.velocityLimit, _SPEED)

    def torque(self, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray, model: pin.Model | None = None) -> np.ndarray:
        """Return Pinocchio's inverse dynamics (N, n) [N m], of a changed model if given."""
        model = self.model if model is None else model
        data = model.createData()
        return np.stack([pin.rnea(model, data, *row).copy() for row in zip(q, qd, qdd, strict=True)])

    def regressor(self, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
        """Return Pinocchio's columns of the inertial parameters, (N, n, 10 n)."""
        data = self.model.createData()
        rows = zip(q, qd, qdd, strict=True)
        return np.stack([pin.computeJointTorqueRegressor(self.model, data, *row).copy() for row in rows])

    def inertias(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return what a joint's motor meets [kg m^2] on some of the positions (N, n).

        Returns:
            held: (n,) mean, when all other joints are held.
            free: (n,) least, when they are free.
        """
        data, held, free = self.model.createData(), [], []
        for row in q[:: max(1, len(q) // 20)]:
            held.append(np.diag(pin.crba(self.model, data, row)).copy())
            free.append(1.0 / np.diag(pin.computeMinverse(self.model, data, row)))
        return np.mean(held, axis=0), np.min(free, axis=0)

    def inertials(self) -> dict[str, list[float]]:
        """Return [m, mcx, mcy, mcz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz] about each link's origin."""
        bodies = list(self.model.inertias)[1:]
        return {link: body.toDynamicParameters().tolist() for link, body in zip(self.links, bodies, strict=True)}

    def with_cad_error(self, seed: int, size: float) -> Robot:
        """Return the robot as its URDF tells it: every link's inertials off by about ``size``, physical again."""
        return Robot(self.name, urdf_of(with_wrong_inertials(self.model, np.random.default_rng(seed), size)))


def draw_robot(rng: np.random.Generator, of: str) -> Robot:
    """Draw a public arm or a random one, equally often.

    Args:
        of: "development" or "final".
    """
    if rng.random() < 0.5:
        return random_robot(of, int(rng.integers(10_000)))
    return public_robot(of, str(rng.choice(sorted(PUBLIC[of]))))


def public_robot(of: str, name: str) -> Robot:
    """Return an arm of example-robot-data."""
    return public_arm(name, *PUBLIC[of][name])


def public_arm(name: str, file: str, pattern: str) -> Robot:
    """Return an arm of a file below example-robot-data's robots/; joints of other names are locked."""
    package = metadata.distribution("example-robot-data")
    folder = Path(str(package.locate_file("cmeel.prefix/share/example-robot-data/robots")))
    model = pin.buildModelFromUrdf(str(folder / file))
    locked = [k for k in range(1, model.njoints) if not re.fullmatch(pattern, model.names[k])]
    return Robot(name, urdf_of(_bounded(pin.buildReducedModel(model, locked, pin.neutral(model)))))


def _bounded(model: pin.Model) -> pin.Model:
    """Return the model with one angle for every joint; Pinocchio has a point on a circle where there is no limit."""
    data, plain = model.createData(), pin.Model()
    pin.forwardKinematics(model, data, pin.neutral(model))
    for k in range(1, model.njoints):
        joint, v = model.joints[k], model.joints[k].idx_v
        low, high = -2 * np.pi, 2 * np.pi
        if joint.nq == 1:
            low, high = model.lowerPositionLimit[joint.idx_q], model.upperPositionLimit[joint.idx_q]
        bounds = (np.array([x]) for x in (model.effortLimit[v], model.velocityLimit[v], low, high))
        axis = np.asarray(data.joints[k].S)[3:].ravel()
        revolute = pin.JointModelRevoluteUnaligned(axis)
        added = plain.addJoint(model.parents[k], revolute, model.jointPlacements[k], model.names[k], *bounds)
        plain.appendBodyToJoint(added, model.inertias[k], pin.SE3.Identity())
    return plain


def random_robot(of: str, number: int) -> Robot:
    """Return a serial arm of 3 to 7 joints that twists and bends in turn, on the floor or on a wall."""
    rng = np.random.default_rng([SETS.index(of), number, 23])
    n, model, length = int(rng.integers(3, 8)), pin.Model(), 0.1
    size, taper = float(rng.uniform(0.6, 1.5)), float(rng.uniform(0.6, 0.8))
    turn = pin.exp3(np.array([np.pi / 2 if rng.random() < 0.2 else 0.0, 0.0, 0.0]))
    for k in range(n):
        bends = k % 2 == 1 or rng.random() < 0.25
        axis = np.array([0.0, rng.choice([-1.0, 1.0]), 0.0]) if bends else np.array([0.0, 0.0, 1.0])
        axis = pin.exp3(0.02 * rng.standard_normal(3)) @ axis if rng.random() < 0.3 else axis
        origin = np.array([*(size * rng.uniform(-0.06, 0.06, 2)), length])
        placement = pin.SE3(turn @ pin.exp3(np.array([0.0, 0.0, rng.uniform(-1.0, 1.0)])), origin)
        bounds = (np.array([v]) for v in (300.0, rng.uniform(1.8, 3.0), -rng.uniform(1.6, 2.8), rng.uniform(1.6, 2.8)))
        added = model.addJoint(k, pin.JointModelRevoluteUnaligned(axis), placement, f"joint{k + 1}", *bounds)
        length = size * float(rng.uniform(0.12, 0.3)) * (1.0 - 0.08 * k)
        mass = 6.0 * size * taper**k * float(rng.uniform(0.7, 1.3))
        centre = np.array([*(0.15 * length * rng.uniform(-1, 1, 2)), rng.uniform(0.3, 0.6) * length])
        radii = length * np.array([*rng.uniform(0.15, 0.3, 2), 0.3])
        tilt = pin.exp3(0.3 * rng.standard_normal(3))
        second = mass * tilt @ np.diag(radii**2) @ tilt.T
        body = pin.Inertia(mass, centre, np.trace(second) * np.eye(3) - second)
        model.appendBodyToJoint(added, body, pin.SE3.Identity())
        turn = np.eye(3)
    return Robot(f"random{number}", urdf_of(model))
