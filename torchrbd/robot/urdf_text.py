"""A description as URDF text, with all digits, for robots that came from another format."""

from __future__ import annotations

import math

import lxml.etree as etree
import torch
from scipy.spatial.transform import Rotation
from torch import Tensor

from torchrbd.robot.description import Description, Joint, Link
from torchrbd.robot.inertia import inertia_matrix, transform_inertia

_INERTIA = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}


def urdf_text(robot: Description) -> bytes:
    """Return URDF with the same links and joints; URDF has no rotors and no springs."""
    root = etree.Element("robot", name=robot.name)
    for link in robot.links:
        _write_link(root, link)
    for joint in robot.joints:
        _write_joint(root, joint)
    etree.indent(root)
    return etree.tostring(root, xml_declaration=True, encoding="utf-8", pretty_print=True)


def _write_link(root: etree._Element, link: Link) -> None:
    element = etree.SubElement(root, "link", name=link.name)
    mass = float(link.pi[0])
    if not bool(link.pi.any()):
        return
    inertial, pose = etree.SubElement(element, "inertial"), torch.eye(4, dtype=torch.float64)
    if mass > 0:
        pose[:3, 3] = -link.pi[1:4] / mass
    inertia = inertia_matrix(transform_inertia(link.pi, pose))
    etree.SubElement(inertial, "origin", xyz=_text(-pose[:3, 3]))
    etree.SubElement(inertial, "mass", value=repr(mass))
    etree.SubElement(inertial, "inertia", {name: repr(float(inertia[at])) for name, at in _INERTIA.items()})


def _write_joint(root: etree._Element, joint: Joint) -> None:
    unlimited = joint.kind == "revolute" and not (math.isfinite(joint.lower) and math.isfinite(joint.upper))
    element = etree.SubElement(root, "joint", name=joint.name, type="continuous" if unlimited else joint.kind)
    rpy = Rotation.from_matrix(joint.pose[:3, :3].numpy()).as_euler("xyz")
    etree.SubElement(element, "origin", xyz=_text(joint.pose[:3, 3]), rpy=_text(torch.from_numpy(rpy)))
    etree.SubElement(element, "parent", link=joint.parent)
    etree.SubElement(element, "child", link=joint.child)
    if joint.kind == "fixed":
        return
    etree.SubElement(element, "axis", xyz=_text(joint.axis))
    names = ("effort", "velocity") if unlimited else ("lower", "upper", "effort", "velocity")
    limits = {name: repr(value) for name in names if math.isfinite(value := getattr(joint, name))}
    if limits:
        etree.SubElement(element, "limit", limits)
    if joint.damping or joint.friction:
        etree.SubElement(element, "dynamics", damping=repr(joint.damping), friction=repr(joint.friction))
    if joint.mimic is not None:
        line = {"multiplier": repr(joint.mimic.multiplier), "offset": repr(joint.mimic.offset)}
        etree.SubElement(element, "mimic", {"joint": joint.mimic.joint} | line)


def _text(values: Tensor) -> str:
    return " ".join(repr(value) for value in values.tolist())
