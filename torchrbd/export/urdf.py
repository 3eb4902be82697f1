"""An identified robot as URDF: the original with new numbers; comments, meshes, mimic and gazebo tags stay."""

from __future__ import annotations

import torch
from lxml import etree
from torch import Tensor

from torchrbd.errors import RobotError
from torchrbd.export.xml_text import comment, element_text
from torchrbd.model import RigidBodyDynamics
from torchrbd.parameters import PARAMETERS_PER_BODY, is_physical
from torchrbd.physics import Term
from torchrbd.robot import FoldedLink, inertia_matrix, transform_inertia


def to_urdf(model: RigidBodyDynamics) -> bytes:
    """Write a model's inertial parameters and friction into the URDF that it came from.

    Links fixed to a moving link keep their own inertia; the moving link takes the rest. If the rest is no physical
    body, the moving link takes all and the fixed ones lose theirs. Terms that URDF has no word for are named in a
    comment at their joint, or at the end if they sit at none, with what they are in MJCF.

    Raises:
        RobotError: the robot was not made from a URDF.
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
        if joint.get("name") in robot.joint_names:
            _write_dynamics(joint, model, robot.joint_names.index(joint.get("name")))
    root.extend(_comment(term) for term in model.terms if term.site.joint is None)
    etree.indent(root)
    return etree.tostring(root.getroottree(), xml_declaration=True, encoding="utf-8", pretty_print=True)


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
    m, c = float(pi[0]), pi[1:4] / pi[0]
    central = inertia_matrix(pi) - m * ((c @ c) * torch.eye(3, dtype=pi.dtype) - torch.outer(c, c))
    inertial = etree.Element("inertial")
    etree.SubElement(inertial, "origin", xyz=" ".join(repr(v) for v in c.tolist()), rpy="0 0 0")
    etree.SubElement(inertial, "mass", value=repr(m))
    entries = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}
    etree.SubElement(inertial, "inertia", {name: repr(float(central[at])) for name, at in entries.items()})
    link.insert(0, inertial)


def _write_dynamics(joint: etree._Element, model: RigidBodyDynamics, index: int) -> None:
    values: dict[str, float] = {}
    for term in model.terms:
        if term.site.joint == index:
            # A URDF is of a robot in one condition: what acts in some recordings only is told beside it.
            written = term.effect.urdf_dynamics(term.parameters_by_name()) if term.site.always else {}
            for name, value in written.items():
                values[name] = values.get(name, 0.0) + value
            if not written:
                joint.append(_comment(term))
    if values:
        dynamics = joint.find("dynamics")
        dynamics = etree.SubElement(joint, "dynamics") if dynamics is None else dynamics
        for name, value in values.items():
            dynamics.set(name, repr(value))


def _comment(term: Term) -> etree._Element:
    written = term.effect.mjcf(term.parameters_by_name())
    words = [
        f"torchrbd: {term.extra_repr()}",
        "URDF has no word for it",
        *(element_text(*one) for one in written.items()),
    ]
    if term.effect.export_note:
        words.append(term.effect.export_note)
    return comment("; ".join(words))
