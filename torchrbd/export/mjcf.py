"""A model as MJCF, MuJoCo's own format: tree, inertias, joints, friction, springs, couplings and actuators."""

from __future__ import annotations

import math
from typing import Any

import torch
from lxml import etree
from scipy.spatial.transform import Rotation
from torch import Tensor

from torchrbd.display import Remark
from torchrbd.export.conditions import conditions_not_exported
from torchrbd.export.drive import Drive
from torchrbd.export.gathered import Gathered, gather
from torchrbd.export.inertials import inertial
from torchrbd.export.xml_text import comment, text
from torchrbd.model import RigidBodyDynamics
from torchrbd.parameters import PARAMETERS_PER_BODY
from torchrbd.robot import RobotModel
from torchrbd.robot.description import Joint

# As hard as MuJoCo's default time step of 2 ms allows.
_HARD = {"solref": "0.004 1", "solimp": "0.999 0.999 0.001 0.5 2"}
# The shortest time step for which delays have their history [s].
_SHORTEST_STEP = 5e-4


def to_mjcf(model: RigidBodyDynamics) -> bytes:
    """Write a model as an MJCF file.

    Links are bodies and keep their names; a moving link has the inertia of all that is fixed to it. Numbers that
    several terms give add. A joint's actuator takes the torque that a recording has, or the set-point where the model
    has a position drive. What MJCF cannot hold stands in comments at the head of the file, see ``not_exported``. MuJoCo
    is not needed.

        mj_inverse = model(q, qd, qdd)    where the file holds the model, dry friction in motion

    Returns:
        the file, UTF-8.

    Raises:
        PhysicalError: a link's inertial parameters are those of no rigid body, or a joint's friction is negative.
    """
    return _write(model)[0]


def not_in_mjcf(model: RigidBodyDynamics) -> tuple[Remark, ...]:
    """Return what ``to_mjcf`` cannot write.

    Raises:
        PhysicalError: a link's inertial parameters are those of no rigid body, or a joint's friction is negative.
    """
    return _write(model)[1]


def _write(model: RigidBodyDynamics) -> tuple[bytes, tuple[Remark, ...]]:
    """Return the file and what it does not hold."""
    robot, found = model.robot, gather(model)
    not_exported = list(found.not_exported)
    root = etree.Element("mujoco", model=robot.name)
    world = etree.Element("worldbody")
    upright = torch.eye(4, dtype=torch.float64)
    base = etree.SubElement(world, "body", {"name": _base_name(robot)} | _place(upright, found, None))
    _write_links(base, model, found, not_exported)
    not_exported += [*_further(robot, found), *_lag_remarks(model, found), *conditions_not_exported(model)]
    root.append(comment(f"torchrbd: {Remark('what the file lacks')}"))
    root.extend(comment(str(one)) for one in not_exported)
    etree.SubElement(root, "compiler", angle="radian", autolimits="true", inertiafromgeom="false")
    etree.SubElement(root, "option", gravity=text(robot.gravity.tolist()))
    if any(drive.frictionloss for drive in found.drives):
        hard = {f"{name}friction": value for name, value in _HARD.items()}
        etree.SubElement(etree.SubElement(root, "default"), "joint", hard)
    root.append(world)
    root.extend(part for part in (_equality(robot), _tendons(robot, found), *_actuators(model, found)) if len(part))
    etree.indent(root)
    return etree.tostring(root, xml_declaration=True, encoding="utf-8", pretty_print=True), tuple(not_exported)


def _base_name(robot: RobotModel) -> str:
    """Return the root link's name; MuJoCo keeps "world" for itself."""
    name, taken = robot.description.root(), {link.name for link in robot.description.links}
    while name == "world" or (name != robot.description.root() and name in taken):
        name += "_link"
    return name


def _place(pose: Tensor, found: Gathered, joint: int | None) -> dict[str, str]:
    """Return position and orientation of a joint's body or, for None, of the base, with what terms say of them."""
    pose = pose.clone()
    if joint in found.shifts:
        pose[:3, 3] += found.shifts[joint]
    for w, *axis in found.turns.get(joint, ()):
        pose[:3, :3] = torch.from_numpy(Rotation.from_quat([*axis, w]).as_matrix()) @ pose[:3, :3]
    return _pose(pose)


def _pose(pose: Tensor) -> dict[str, str]:
    p = pose[:3, 3]
    *axis, w = Rotation.from_matrix(pose[:3, :3].numpy()).as_quat().tolist()
    place = {"pos": text(p.tolist())} if bool(p.any()) else {}
    return place | ({"quat": text((w, *axis))} if any(axis) else {})


def _write_links(base: etree._Element, model: RigidBodyDynamics, found: Gathered, not_exported: list[Remark]) -> None:
    """Write what hangs on the base, depth-first in the robot's order."""
    robot = model.robot
    bodies = dict(zip(robot.body_names, model.pi.detach().cpu().reshape(-1, PARAMETERS_PER_BODY), strict=True))
    for index, added in found.added.items():
        bodies[robot.body_names[index]] = bodies[robot.body_names[index]] + added
    below: dict[str, list[Joint]] = {link.name: [] for link in robot.description.links}
    for joint in robot.description.joints:
        below[joint.parent].append(joint)
    stack = [(joint, base) for joint in reversed(below[robot.description.root()])]
    while stack:
        joint, parent = stack.pop()
        driven = robot.joint_names.index(joint.name) if joint.name in robot.joint_names else None
        place = _place(joint.pose, found, driven) if driven is not None else _pose(joint.pose)
        body = etree.SubElement(parent, "body", {"name": joint.child} | place)
        if joint.kind != "fixed":
            etree.SubElement(body, "joint", _joint(joint, None if driven is None else found.drives[driven]))
            attributes, remarks = inertial(bodies[joint.child], joint.child)
            etree.SubElement(body, "inertial", attributes)
            not_exported += remarks
        stack.extend((child, body) for child in reversed(below[joint.child]))


def _joint(joint: Joint, drive: Drive | None) -> dict[str, str]:
    """Return a joint's attributes; one that mimics another has no drive."""
    written = {
        "name": joint.name,
        "type": "slide" if joint.kind == "prismatic" else "hinge",
        "axis": text(joint.axis.tolist()),
    }
    if math.isfinite(joint.lower) and math.isfinite(joint.upper) and joint.lower < joint.upper:
        written["range"] = text((joint.lower, joint.upper))
    if drive is None:
        return written
    if math.isfinite(joint.effort) and joint.effort > 0:
        written["actuatorfrcrange"] = text((-joint.effort, joint.effort))
    values = {name: getattr(drive, name) for name in ("frictionloss", "armature", "stiffness", "ref")}
    if drive.stiffness:
        values["springref"] = -drive.at_zero / drive.stiffness
    if drive.drag:
        values["damping"] = (drive.damping, drive.drag, 0.0)
    else:
        values["damping"] = drive.damping
    return written | {name: text(value) for name, value in values.items() if value}


def _equality(robot: RobotModel) -> etree._Element:
    """Hold mimic joints to the joints that they follow."""
    part = etree.Element("equality")
    for joint in robot.description.joints:
        if joint.mimic is not None and joint.kind != "fixed":
            line = text((joint.mimic.offset, joint.mimic.multiplier, 0.0, 0.0, 0.0))
            held = {"joint1": joint.name, "joint2": joint.mimic.joint, "polycoef": line}
            etree.SubElement(part, "joint", held | _HARD)
    return part


def _tendons(robot: RobotModel, found: Gathered) -> etree._Element:
    part = etree.Element("tendon")
    for one in found.tendons:
        known = ("stiffness", "damping", "frictionloss", "armature")
        values = {name: text(getattr(one, name)) for name in known if getattr(one, name)}
        tendon = etree.SubElement(part, "fixed", {"springlength": text(one.springlength)} | values)
        for joint, coef in zip(one.joints, one.coef, strict=True):
            etree.SubElement(tendon, "joint", joint=robot.joint_names[joint], coef=text(coef))
    return part


def _actuators(model: RigidBodyDynamics, found: Gathered) -> tuple[etree._Element, etree._Element]:
    """Return actuators, and sensors of what is read of them.

    The control is the set-point of a joint that has a position drive, else the torque that is recorded.
    """
    actuators, sensors = etree.Element("actuator"), etree.Element("sensor")
    followed, late = ({}, 0.0) if model.drives is None else (model.drives.of, max(model.drives.delay_s, 0.0))
    for name, drive in zip(model.robot.joint_names, found.drives, strict=True):
        written: dict[str, float | tuple[float, ...] | str] = {"name": name, "joint": name}
        # A spring without stiffness is a constant torque.
        constant = drive.offset + (0.0 if drive.stiffness else drive.at_zero)
        limit, delay, own = drive.limit, drive.delay, followed.get(name)
        if own is not None:
            kp, kd = own.kp / drive.gain, own.kd / drive.gain
            written |= {"gainprm": kp, "biastype": "affine", "biasprm": (-constant, -kp, -kd)}
            limit, delay = min(limit, own.limit / drive.gain), delay + late
        elif drive.gain != 1.0:
            written["gainprm"] = 1.0 / drive.gain
        if constant and own is None:
            written |= {"biastype": "affine", "biasprm": (-constant, 0.0, 0.0)}
        if drive.lag and own is None:
            written |= {"dyntype": "filterexact", "dynprm": drive.lag}
        if math.isfinite(limit):
            written["forcerange"] = (-limit, limit)
        etree.SubElement(actuators, "general", {k: text(v) for k, v in written.items()} | _history(delay))
        reading = _history(drive.late) | ({"cutoff": text(drive.clipped)} if math.isfinite(drive.clipped) else {})
        if reading:
            etree.SubElement(sensors, "actuatorfrc", {"name": f"{name}_torque", "actuator": name} | reading)
    return actuators, sensors


def _lag_remarks(model: RigidBodyDynamics, found: Gathered) -> list[Remark]:
    """Return the lags of joints with a position drive, which are not written."""
    followed = {} if model.drives is None else model.drives.of
    pairs = zip(model.robot.joint_names, found.drives, strict=True)
    joints = [name for name, drive in pairs if drive.lag and name in followed]
    return [Remark("lag of a drive", {"joints": joints})] if joints else []


def _history(delay: float) -> dict[str, str]:
    return {"delay": text(delay), "nsample": str(math.ceil(delay / _SHORTEST_STEP) + 1)} if delay else {}


def _further(robot: RobotModel, found: Gathered) -> list[Remark]:
    """Return what is to be known of any such file."""
    pairs, joints = list(zip(robot.joint_names, found.drives, strict=True)), robot.description.joints
    moving = [j for j in joints if j.kind != "fixed"]
    rubbing = [name for name, drive in pairs if drive.frictionloss]
    late = [name for name, drive in pairs if drive.delay or drive.late]
    drag = [name for name, drive in pairs if drive.drag]
    followers = [joint.name for joint in joints if joint.mimic is not None]
    half = [j.name for j in joints if math.isfinite(j.lower) != math.isfinite(j.upper)]
    empty = [j.name for j in moving if math.isfinite(j.lower) and math.isfinite(j.upper) and j.lower >= j.upper]
    weak = [j.name for j in moving if j.mimic is None and j.effort <= 0]
    named: list[tuple[list[str], str, dict[str, Any]]] = [
        (rubbing, "dry friction near rest", {}),
        (late, "delays", {"step_s": _SHORTEST_STEP}),
        (drag, "damping of three numbers", {}),
        (followers, "following joints", {}),
        (half, "limits", {"fault": "one side"}),
        (empty, "limits", {"fault": "empty"}),
        (weak, "limits", {"fault": "effort"}),
    ]
    remarks = [Remark(kind, {"joints": names, **values}) for names, kind, values in named if names]
    if bool(torch.isfinite(robot.velocity).any()):
        remarks.append(Remark("velocity limits"))
    return [*remarks, Remark("shapes")]
