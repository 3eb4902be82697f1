"""Read URDF. Errors that yourdfpy would repair silently (missing numbers, lost tags) are rejected, with their place."""

from __future__ import annotations

import io
import math
from typing import Any

import lxml.etree as etree
import torch
import yourdfpy
from torch import Tensor

from torchrbd.errors import RobotError
from torchrbd.robot.description import Description, Joint, Link, Mimic
from torchrbd.robot.inertia import transform_inertia

INERTIA = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
# Limits of masses [kg], lengths [m] and inertias [kg m^2] of a plausible robot.
_LARGEST, _LEAST_MASS = 1e9, 1e-9
KINDS = {"revolute": "revolute", "continuous": "revolute", "prismatic": "prismatic", "fixed": "fixed"}
JOINT_NUMBERS = {
    "dynamics": ("damping", "friction"),
    "limit": ("lower", "upper", "velocity", "effort"),
    "mimic": ("multiplier", "offset"),
}


def read_urdf(where: str, text: bytes, root: etree._Element) -> Description:
    """Read a robot from URDF.

    Args:
        where: its name in messages.
        text: the file's text.
        root: the same, parsed.

    Raises:
        RobotError: it is not plain URDF, or a number that the dynamics need is missing or invalid.
    """
    _check_root(where, root)
    for link in root.findall("link"):
        _check_link(where, link)
    for joint in root.findall("joint"):
        _check_joint(where, joint)
    # Shapes and colours do not affect dynamics, and their meshes would be searched for.
    for tag in ("visual", "collision", "material", "transmission", "gazebo"):
        etree.strip_elements(root, tag, with_tail=False)
    # yourdfpy's types allow that anything is missing; the checks above exclude that.
    robot: Any = yourdfpy.URDF.load(
        io.BytesIO(etree.tostring(root)), build_scene_graph=False, load_meshes=False, filename_handler=str
    ).robot
    links = tuple(_link(link) for link in robot.links)
    joints = tuple(_joint(joint) for joint in robot.joints)
    return Description(robot.name, links, joints, where, text)


def _check_root(where: str, root: etree._Element) -> None:
    """Reject unprocessed xacro, and other files."""
    for element in root.iter():
        if "xacro" in (element.prefix or "") or "xacro" in (etree.QName(element).namespace or ""):
            raise RobotError(
                f"{where}, line {element.sourceline}: <xacro:{etree.QName(element).localname}> is left in the file; "
                f"make a URDF of it: xacro {'FILE' if where == 'URDF text' else where} > expanded.urdf"
            )
    if root.tag != "robot":
        raise RobotError(
            f"{where}: the root tag is <{root.tag}>, expected <robot>, or <mujoco> of MJCF; is this a URDF file?"
        )
    _name(where, root)


def _name(where: str, element: etree._Element) -> str:
    """Return the name of a robot, link or joint."""
    if not (name := element.get("name")):
        raise RobotError(f'{where}, line {element.sourceline}: <{element.tag}> has no name; add name="..."')
    return name


def _check_link(where: str, link: etree._Element) -> None:
    """Reject an inertial that is incomplete or has invalid numbers."""
    place = f"{where}: link '{_name(where, link)}'"
    if (inertial := link.find("inertial")) is None:
        return
    _check_origin(place, inertial)
    for tag, names in (("mass", ("value",)), ("inertia", INERTIA)):
        if (element := inertial.find(tag)) is None:
            raise RobotError(f"{place}: <inertial> has no <{tag}>; add it, or leave out <inertial> for a massless link")
        if missing := [name for name in names if name not in element.attrib]:
            raise RobotError(f"{place}: <{tag}> lacks {', '.join(missing)}; give all of {', '.join(names)}")
        for name in names:
            value = _numbers(place, element, name, 1)[0]
            if name == "value" and value < 0:
                raise RobotError(f"{place}: mass is {value:g}, expected 0 or more; correct <mass value>")
            if name == "value" and 0 < value < _LEAST_MASS:
                raise RobotError(
                    f"{place}: mass is {value:g}, less than {_LEAST_MASS:g} kg; correct <mass value> or give 0"
                )


def _check_joint(where: str, joint: etree._Element) -> None:
    """Reject a joint of an unsupported kind, or with invalid numbers."""
    place = f"{where}: joint '{_name(where, joint)}'"
    kind = joint.get("type")
    if kind not in KINDS:
        raise RobotError(
            f"{place} has type '{kind}', expected one of {', '.join(KINDS)}; replace it by such joints, "
            "or make it fixed to identify the robot on a fixed base"
        )
    for role in ("parent", "child"):
        if (element := joint.find(role)) is None or not element.get("link"):
            raise RobotError(f'{place} has no {role} link; add <{role} link="..."/>')
    _check_origin(place, joint)
    axis = joint.find("axis")
    if axis is not None and "xyz" in axis.attrib and not any(_numbers(place, axis, "xyz", 3)) and kind != "fixed":
        raise RobotError(f"{place}: <axis xyz> is zero; give the direction of the joint's axis")
    for tag, names in JOINT_NUMBERS.items():
        if (element := joint.find(tag)) is not None:
            for name in names:
                _numbers(place, element, name, 1, finite=tag != "limit")
    if (mimic := joint.find("mimic")) is not None and not mimic.get("joint"):
        raise RobotError(f'{place}: <mimic> names no joint; add joint="..."')


def _check_origin(place: str, element: etree._Element) -> None:
    """Reject an <origin> with invalid numbers."""
    if (origin := element.find("origin")) is not None:
        for name in ("xyz", "rpy"):
            _numbers(place, origin, name, 3)


def _numbers(place: str, element: etree._Element, name: str, count: int, finite: bool = True) -> list[float]:
    """Return an attribute's numbers; an empty list if it is absent."""
    if (text := element.get(name)) is None:
        return []
    try:
        values = [float(word) for word in text.split()]
    except ValueError:
        values = []
    if len(values) != count or any(math.isnan(v) or (finite and math.isinf(v)) for v in values):
        expected = "a number" if count == 1 else f"{count} numbers"
        raise RobotError(f'{place}: <{element.tag} {name}="{text}">: expected {expected}; correct it')
    if finite and any(abs(v) > _LARGEST for v in values):
        raise RobotError(
            f'{place}: <{element.tag} {name}="{text}">: more than any robot has, {_LARGEST:g} in SI units; correct it'
        )
    return values


def _pose(origin: Any) -> Tensor:
    """Return an origin as a (4, 4) pose."""
    return torch.eye(4, dtype=torch.float64) if origin is None else torch.as_tensor(origin, dtype=torch.float64)


def _link(link: Any) -> Link:
    """Transform the inertial from its own frame to the link's."""
    pi = torch.zeros(10, dtype=torch.float64)
    if (inertial := link.inertial) is None:
        return Link(link.name, pi)
    inertia = inertial.inertia
    pi[0] = inertial.mass
    pi[4:] = torch.tensor([inertia[0, 0], inertia[0, 1], inertia[1, 1], inertia[0, 2], inertia[1, 2], inertia[2, 2]])
    return Link(link.name, transform_inertia(pi, _pose(inertial.origin)))


def _joint(joint: Any) -> Joint:
    """Normalise the axis; missing limits are infinite."""
    axis = torch.as_tensor(joint.axis, dtype=torch.float64)
    limit, dynamics, mimic = joint.limit, joint.dynamics, joint.mimic
    limits = {name: getattr(limit, name, None) for name in JOINT_NUMBERS["limit"]}
    if joint.type == "continuous":
        limits.update(lower=None, upper=None)
    friction = {name: float(getattr(dynamics, name, None) or 0.0) for name in JOINT_NUMBERS["dynamics"]}
    return Joint(
        name=joint.name,
        kind=KINDS[joint.type],
        parent=joint.parent,
        child=joint.child,
        pose=_pose(joint.origin),
        axis=axis / axis.norm(),
        mimic=None if mimic is None else Mimic(mimic.joint, mimic.multiplier, mimic.offset),
        **friction,
        **{name: value for name, value in limits.items() if value is not None},
    )
