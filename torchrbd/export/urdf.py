"""An identified robot as URDF: the original with new numbers; comments, meshes, mimic and gazebo tags stay."""

from __future__ import annotations

from collections.abc import Iterable

import torch
from lxml import etree
from torch import Tensor

from torchrbd.display import Remark
from torchrbd.effects import Term
from torchrbd.errors import PhysicalError, RobotError
from torchrbd.export.conditions import conditions_not_exported
from torchrbd.export.gathered import left_out, refuse_negative
from torchrbd.export.xml_text import comment, element_text
from torchrbd.model import RigidBodyDynamics
from torchrbd.parameters import PARAMETERS_PER_BODY, is_physical
from torchrbd.robot import STANDARD_GRAVITY, FoldedLink, RobotModel, inertia_matrix, transform_inertia

_FRICTION = "damping", "friction"


def to_urdf(model: RigidBodyDynamics, warnings: Iterable[str] = ()) -> bytes:
    """Write a model's inertial parameters and friction into the URDF that it came from.

    Links fixed to a moving link keep their own inertia; the moving link takes the rest. If the rest is no physical
    body, the moving link takes all and the fixed ones lose theirs. <dynamics> hold the model's friction and no other:
    what the URDF had and the model has not goes. What URDF cannot hold, see ``not_exported``, stands in comments at its
    joint, or at the end if it is at none, with what it is in MJCF.

    Args:
        model: the model.
        warnings: what a reader of the file has to know first; comments at its head.

    Raises:
        RobotError: the robot was not made from a URDF.
        PhysicalError: a link has a centre of mass and no mass, or a joint's friction is negative.
    """
    robot = model.robot
    if robot.urdf is None:
        raise RobotError(f"robot '{robot.name}' was not made from a URDF, so there is no text to write into")
    root = etree.fromstring(robot.urdf)
    links = {element.get("name"): element for element in root.findall("link")}
    for body, pi in zip(robot.body_names, model.pi.detach().reshape(-1, PARAMETERS_PER_BODY), strict=True):
        for name, own in _shared_out(pi, robot.folded[body]):
            _write_inertial(links[name], own)
    for joint in root.findall("joint"):
        # Friction of a joint that follows another is no part of the model.
        index = robot.joint_names.index(joint.get("name")) if joint.get("name") in robot.joint_names else None
        _write_dynamics(joint, {} if index is None else _dynamics(model, index))
        if index is not None:
            joint.extend(_comment(term, robot) for term in _left_out(model) if term.site.joint == index)
    root.extend(_comment(term, robot) for term in _left_out(model) if term.site.joint is None)
    root.extend(comment(f"torchrbd: {one}") for one in conditions_not_exported(model))
    root[:0] = [comment(f"torchrbd: WARNING: {words}") for words in warnings]
    etree.indent(root)
    return etree.tostring(root.getroottree(), xml_declaration=True, encoding="utf-8", pretty_print=True)


def not_in_urdf(model: RigidBodyDynamics) -> tuple[Remark, ...]:
    """Return what ``to_urdf`` cannot write.

    Raises:
        PhysicalError: a joint's friction is negative.
    """
    robot = model.robot
    remarks = [_remark(term, robot) for term in _left_out(model)]
    for index in range(robot.n_dof):
        _dynamics(model, index)
    if bool((robot.gravity != robot.gravity.new_tensor(STANDARD_GRAVITY)).any()):
        remarks.append(Remark("gravity not in URDF", {"gravity": robot.gravity.tolist()}))
    return (*remarks, *conditions_not_exported(model))


def _shared_out(pi: Tensor, folded: tuple[FoldedLink, ...]) -> list[tuple[str, Tensor]]:
    """Return the inertial parameters of every link of a body, each about its own origin."""
    own, *fixed = folded
    rest = pi - sum((transform_inertia(link.pi, link.pose) for link in fixed), torch.zeros_like(pi))
    if not fixed or bool(is_physical(rest)) or not bool(pi.any()):
        return [(own.name, rest)]
    return [(own.name, pi), *((link.name, torch.zeros_like(pi)) for link in fixed)]


def _write_inertial(link: etree._Element, pi: Tensor) -> None:
    for old in link.findall("inertial"):
        link.remove(old)
    if not pi.any():
        return
    m = float(pi[0])
    if not m and pi[1:4].any():
        raise PhysicalError(f"{link.get('name')}: has no mass and a centre of mass; re-fit the link")
    c = pi[1:4] / m if m else pi[1:4]
    central = inertia_matrix(pi) - m * ((c @ c) * torch.eye(3, dtype=pi.dtype) - torch.outer(c, c))
    inertial = etree.Element("inertial")
    etree.SubElement(inertial, "origin", xyz=" ".join(repr(v) for v in c.tolist()), rpy="0 0 0")
    etree.SubElement(inertial, "mass", value=repr(m))
    entries = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}
    etree.SubElement(inertial, "inertia", {name: repr(float(central[at])) for name, at in entries.items()})
    link.insert(0, inertial)


def _dynamics_of(term: Term) -> dict[str, float]:
    """Return what a term adds to <dynamics>; a URDF is of a robot in one condition, so nothing for a time."""
    return term.effect.urdf_dynamics(term.parameters_by_name()) if term.site.always else {}


def _sums(model: RigidBodyDynamics, joint: int) -> dict[str, float]:
    """Return what the terms at a joint add up to, by attribute of <dynamics>."""
    sums: dict[str, float] = {}
    for term in model.terms:
        if term.site.joint == joint:
            for name, value in _dynamics_of(term).items():
                sums[name] = sums.get(name, 0.0) + value
    return sums


def _dynamics(model: RigidBodyDynamics, joint: int) -> dict[str, float]:
    """Return the attributes of <dynamics>.

    Raises:
        PhysicalError: one of them is negative.
    """
    found = {name: v for name, v in _sums(model, joint).items() if v}
    for name, value in found.items():
        refuse_negative(model.robot.joint_names[joint], name, value)
    return found


def _write_dynamics(joint: etree._Element, values: dict[str, float]) -> None:
    """Give a joint the friction of the model and no other."""
    for old in joint.findall("dynamics"):
        for name in _FRICTION:
            old.attrib.pop(name, None)
        if not old.attrib:
            joint.remove(old)
    if values:
        dynamics = joint.find("dynamics")
        dynamics = etree.SubElement(joint, "dynamics") if dynamics is None else dynamics
        dynamics.attrib.update({name: repr(value) for name, value in values.items()})


def _left_out(model: RigidBodyDynamics) -> list[Term]:
    """Return the terms that a URDF does not hold, or not all of."""
    return [term for term in model.terms if term.effect.urdf_note or not _dynamics_of(term)]


def _remark(term: Term, robot: RobotModel) -> Remark:
    """Return what of a term is left out."""
    if not term.site.always:
        return left_out(term, robot, "not always")
    return left_out(term, robot, "URDF", term.effect.urdf_note if _dynamics_of(term) else "")


def _comment(term: Term, robot: RobotModel) -> etree._Element:
    written = term.effect.mjcf(term.parameters_by_name())
    words = [f"torchrbd: {_remark(term, robot)}", *(element_text(*one) for one in written.items())]
    if term.effect.export_note:
        words.append(term.effect.export_note)
    return comment("; ".join(words))
