"""Arms of the raw tier: 6 and 7 joints, links of tubes and motors; development and final ones share no kind.

parallel      z y y y z y   shoulder, elbow and wrist pitch about parallel axes (collaborative arms of six joints)
alternating   z y z y z y z every axis across the last (light arms of seven joints)
cranked       z y x y x y x with offsets between the axes, carried by a shoulder (two-armed robots)
spherical     z y y x y x   three axes of the wrist meet; hangs from a ceiling or leans (industrial arms)
shouldered    x y z y z y   stands upright or lies on its side (arms of humanoids)
stacked       z y y z y z   large offsets; stands or hangs (arms of six joints whose wrists are not spherical)
forearm       z x y z y x   light, without an offset wrist (arms on mobile bases)
lateral       y x z y z y z the first axis lies; upright or leaning (arms at the side of a torso)
boom          z y y y z x   three long links in a plane; stands or leans (arms that load and stack)
slender       z y x z y x y long, thin links; stands or lies on its side (light arms that reach far)
wallmounted   x z z y x z   axes lie; two parallel ones fold in a plane (arms on walls and columns)
elbowed       z x x z x z y two elbows; hangs or stands (arms with a redundant elbow)
inclined      z y z z x y   its second link turns in a plane that its third leaves; leans (arms on slanted rails)
serpent       y z y z y z y seven like links; hangs or lies (arms that reach into something)
crossed       z x y x z y   neighbouring axes are all across; upright or leaning (arms of six joints for assembly)
whip          z y x y z x y links that get lighter; stands or lies on its side (long arms with small wrists)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from ..robots import Robot, public_arm
from ..urdf import urdf_of

_Z, _Y, _X = np.eye(3)[::-1]


@dataclass(frozen=True)
class Kind:
    """A kind of arm.

    Attributes:
        axes: of the joints, where all links point up.
        lengths: from each joint to the next [m], of the mean arm.
        masses: of the links [kg].
        offset: to the side, in parts of a length.
        leans: angles of the base to draw from [rad].
    """

    axes: str
    lengths: Sequence[float]
    masses: Sequence[float]
    offset: float = 0.1
    leans: Sequence[float] = (0.0,)


OWN = {
    "development": {
        "parallel": Kind("zyyyzy", (0.1, 0.45, 0.4, 0.12, 0.1, 0.08), (4.0, 9.0, 4.0, 1.6, 1.4, 0.5), 0.12),
        "alternating": Kind("zyzyzyz", (0.18, 0.2, 0.2, 0.2, 0.2, 0.1, 0.1), (4.0, 4.0, 3.2, 2.8, 1.8, 1.5, 0.4), 0.05),
        "cranked": Kind("zyxyxyx", (0.1, 0.1, 0.28, 0.1, 0.27, 0.08, 0.12), (5.0, 2.5, 3.5, 1.8, 2.4, 1.2, 0.6), 0.3),
        "spherical": Kind("zyyxyx", (0.25, 0.6, 0.15, 0.5, 0.1, 0.08), (30.0, 22.0, 14.0, 8.0, 3.5, 0.8), 0.08,
                          (0.5, np.pi, np.pi)),
        "shouldered": Kind("xyzyzy", (0.08, 0.12, 0.3, 0.06, 0.26, 0.12), (2.2, 2.6, 2.4, 1.2, 1.5, 0.7), 0.15,
                           (0.0, 0.5 * np.pi)),
        "stacked": Kind("zyyzyz", (0.2, 0.5, 0.12, 0.42, 0.09, 0.07), (14.0, 12.0, 6.0, 4.0, 2.2, 0.6), 0.2,
                        (0.0, np.pi)),
        "forearm": Kind("zxyzyx", (0.12, 0.3, 0.08, 0.28, 0.08, 0.06), (3.0, 3.2, 1.4, 1.6, 0.8, 0.4), 0.12),
        "lateral": Kind("yxzyzyz", (0.1, 0.12, 0.3, 0.08, 0.28, 0.08, 0.08), (4.5, 3.5, 4.0, 2.0, 2.2, 1.1, 0.5), 0.15,
                        (0.0, 0.25 * np.pi)),
        "boom": Kind("zyyyzx", (0.25, 0.5, 0.45, 0.15, 0.1, 0.08), (9.0, 8.0, 5.0, 2.2, 1.4, 0.5), 0.1, (0.0, 0.35)),
        "slender": Kind("zyxzyxy", (0.1, 0.1, 0.4, 0.07, 0.38, 0.07, 0.07), (3.2, 2.4, 2.2, 1.6, 1.4, 0.9, 0.4), 0.1,
                        (0.0, 0.5 * np.pi)),
        "wallmounted": Kind("xzzyxz", (0.15, 0.35, 0.35, 0.12, 0.1, 0.07), (5.0, 5.0, 3.0, 1.8, 1.2, 0.5), 0.15,
                            (0.0, 0.5 * np.pi)),
        "elbowed": Kind("zxxzxzy", (0.15, 0.3, 0.25, 0.1, 0.2, 0.08, 0.07), (5.0, 4.5, 3.0, 1.8, 1.5, 0.9, 0.4), 0.12,
                        (0.0, np.pi)),
        "inclined": Kind("zyzzxy", (0.2, 0.35, 0.12, 0.3, 0.1, 0.08), (7.0, 6.0, 2.5, 2.4, 1.3, 0.5), 0.2, (0.4, 0.9)),
        "serpent": Kind("yzyzyzy", (0.12, 0.18, 0.18, 0.18, 0.16, 0.12, 0.08), (3.5, 3.0, 2.6, 2.2, 1.6, 1.0, 0.5),
                        0.05, (0.0, 0.5 * np.pi, np.pi)),
    },
    "final": {
        "crossed": Kind("zxyxzy", (0.15, 0.3, 0.1, 0.28, 0.1, 0.07), (6.0, 5.0, 2.4, 2.2, 1.2, 0.5), 0.15, (0.0, 0.3)),
        "whip": Kind("zyxyzxy", (0.15, 0.25, 0.2, 0.18, 0.15, 0.12, 0.08), (5.5, 4.2, 3.0, 2.0, 1.4, 0.8, 0.4), 0.08,
                     (0.0, 0.5 * np.pi)),
    },
}  # fmt: skip
"""Own kinds of arms of each set."""
PUBLIC = {
    "development": {
        "talos": ("talos_data/robots/talos_left_arm.urdf", r"arm_left_\d_joint"),
        "tiago": ("tiago_description/robots/tiago.urdf", r"arm_\d_joint"),
        "romeo": ("romeo_description/urdf/romeo.urdf", r"R(Shoulder|Elbow|Wrist).*"),
        "xarm": ("xarm_description/urdf/xarm7.urdf", r"joint\d"),
        "ur5": ("ur_description/urdf/ur5_robot.urdf", r".*_joint"),
        "kinova": ("kinova_description/robots/kinova.urdf", r"j2s6s200_joint_\d"),
        "z1": ("z1_description/urdf/z1.urdf", r"joint\d"),
        "baxter": ("baxter_description/urdf/baxter.urdf", r"left_[sew]\d"),
        "tiago_pro": ("tiago_pro_description/robots/tiago_pro.urdf", r"arm_left_\d_joint"),
        "g1": ("g1_description/urdf/g1_29dof_rev_1_0.urdf", r"left_(shoulder|elbow|wrist).*"),
        "centauro": ("centauro_description/urdf/centauro.urdf", r"j_arm1_\d"),
        "pr2": ("pr2_description/urdf/pr2.urdf", r"l_(shoulder|upper_arm|elbow|forearm|wrist)_.*_joint"),
        "alex": ("alex_description/urdf/alex_nub_hands.urdf", r"Left(Shoulder|Elbow|Wrist).*"),
    },
    "final": {
        "humanoid": ("simple_humanoid_description/urdf/simple_humanoid.urdf", r"LARM_(SHOULDER|ELBOW|WRIST).*"),
        "panda": ("panda_description/urdf/panda.urdf", r"panda_joint\d"),
    },
}
"""Arms of example-robot-data, by set: file and joints that move."""


def draw_arm(rng: np.random.Generator, of: str) -> Robot:
    """Draw an arm of a set: an own one in two of three cases."""
    if rng.random() < 1 / 3:
        name = str(rng.choice(sorted(PUBLIC[of])))
        return public_arm(name, *PUBLIC[of][name])
    name = str(rng.choice(sorted(OWN[of])))
    return own_arm(rng, name, OWN[of][name])


def own_arm(rng: np.random.Generator, name: str, kind: Kind) -> Robot:
    """Build an arm of a kind: lengths and masses vary by a quarter, all of it in size by a half."""
    size, n = float(np.exp(rng.uniform(-0.4, 0.3))), len(kind.axes)
    lengths = size * np.asarray(kind.lengths) * rng.uniform(0.75, 1.3, n)
    masses = size**2 * np.asarray(kind.masses) * rng.uniform(0.75, 1.3, n)
    sides = lengths * kind.offset * rng.choice([-1.0, 1.0], n) * rng.uniform(0.5, 1.5, n)
    base, model = pin.exp3(float(rng.choice(kind.leans)) * _X), pin.Model()
    placement = pin.SE3(base, base @ np.array([0.0, 0.0, 0.15 * size]))
    for k, letter in enumerate(kind.axes):
        axis = {"x": _X, "y": _Y, "z": _Z}[letter] * rng.choice([-1.0, 1.0])
        span = float(rng.uniform(1.6, 2.9))
        bounds = (np.array([b]) for b in (400.0, rng.uniform(1.2, 3.0), -span, span))
        joint = model.addJoint(k, pin.JointModelRevoluteUnaligned(axis), placement, f"{name}_{k + 1}", *bounds)
        tip = np.array([sides[k] if letter != "x" else 0.0, sides[k] if letter == "x" else 0.0, lengths[k]])
        model.appendBodyToJoint(joint, _link(rng, float(masses[k]), tip), pin.SE3.Identity())
        placement = pin.SE3(np.eye(3), tip)
    return Robot(name, urdf_of(model))


def _link(rng: np.random.Generator, mass: float, tip: np.ndarray) -> pin.Inertia:
    """Return a tube to the next joint, that one's motor, and cables and covers to the sides."""
    length = float(np.linalg.norm(tip))
    shares = rng.dirichlet([5.0, 5.0, 1.0, 1.0])
    tube, motor = mass * shares[:2]
    radius = float(np.clip(0.2 * length, 0.03, 0.09))
    along = pin.Quaternion.FromTwoVectors(_Z, tip / length).toRotationMatrix()
    body = pin.SE3(along, 0.5 * tip).act(pin.Inertia.FromCylinder(float(tube), radius, length))
    across = pin.exp3(rng.uniform(-np.pi, np.pi, 3))
    body += pin.SE3(across, 0.9 * tip).act(pin.Inertia.FromCylinder(float(motor), radius, 1.5 * radius))
    for share in shares[2:]:
        at = tip * rng.uniform(0, 1) + 1.2 * radius * rng.uniform(-1, 1, 3)
        body += pin.SE3(np.eye(3), at).act(pin.Inertia.FromSphere(float(mass * share), 0.5 * radius))
    return body


def with_wrong_inertials(rng: np.random.Generator, robot: Robot, size: float) -> Robot:
    """Return the arm as its URDF tells it: mass, centre and moments of every link off by about ``size`` at once.

    Mass is off by exp(size N); the centre by size times the link's extent, in any direction; each principal second
    moment by its own exp(size N) and with the mass; the principal axes are turned by about size / 2 rad.
    """
    model = robot.model.copy()
    for k in range(1, model.njoints):
        body = model.inertias[k]
        spread = 0.5 * np.trace(body.inertia) * np.eye(3) - body.inertia
        values, axes = np.linalg.eigh(spread)
        extent = np.linalg.norm(body.lever) + np.sqrt(max(values.sum(), 0.0) / body.mass)
        factor = float(np.exp(size * rng.standard_normal()))
        values = np.maximum(values, 1e-3 * values[-1]) * factor * np.exp(size * rng.standard_normal(3))
        axes = pin.exp3(0.5 * size * rng.standard_normal(3)) @ axes
        spread = axes @ np.diag(values) @ axes.T
        step = rng.standard_normal(3)
        lever = body.lever + size * extent * rng.uniform(0.5, 1.2) * step / np.linalg.norm(step)
        model.inertias[k] = pin.Inertia(factor * body.mass, lever, np.trace(spread) * np.eye(3) - spread)
    return Robot(robot.name, urdf_of(model))
