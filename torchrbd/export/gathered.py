"""What a model's terms are in MJCF, all terms together, and what MJCF cannot hold."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import torch
from torch import Tensor

from torchrbd.display import Remark
from torchrbd.effects import Mjcf, Term
from torchrbd.errors import PhysicalError
from torchrbd.export.drive import Drive
from torchrbd.export.xml_text import Value, element_text
from torchrbd.model import RigidBodyDynamics
from torchrbd.robot import RobotModel

_SAME = 1e-9
# Attributes of actuators and sensors alone.
_IN_TIME = {"dyntype", "dynprm", "delay"}


@dataclass(frozen=True)
class Tendon:
    """A fixed tendon: what it has acts on its length, the sum of coef times joint position."""

    joints: tuple[int, ...]
    coef: tuple[float, ...]
    stiffness: float = 0.0
    damping: float = 0.0
    springlength: Value = 0.0
    frictionloss: float = 0.0
    armature: float = 0.0


@dataclass
class Gathered:
    """All of it.

    Attributes:
        drives: one for each driving joint.
        tendons: over which joints.
        added: what to add to a body's inertial parameters (10,), by index.
        shifts: how far the origins of joints move in their parents' axes (3,) [m], by index.
        turns: quaternions (w, x, y, z) that turn a joint's origin, one after the other; under None those of the base.
        not_exported: what MJCF does not hold.
        in_time: terms that are all in how actuators act in time, which inverse dynamics does not meet.
    """

    drives: list[Drive]
    tendons: list[Tendon] = field(default_factory=list)
    added: dict[int, Tensor] = field(default_factory=dict)
    shifts: dict[int, Tensor] = field(default_factory=dict)
    turns: dict[int | None, list[tuple[float, ...]]] = field(default_factory=dict)
    not_exported: list[Remark] = field(default_factory=list)
    in_time: list[Term] = field(default_factory=list)


def gather(model: RigidBodyDynamics) -> Gathered:
    """Return what the terms of a model are in MJCF.

    Raises:
        PhysicalError: a joint's damping, friction or rotor inertia is negative.
    """
    robot = model.robot
    found = Gathered([Drive() for _ in range(robot.n_dof)])
    couplings: list[Tendon] = []
    for term in model.terms:
        written = term.effect.mjcf(term.parameters_by_name())
        if not term.site.always:
            found.not_exported.append(left_out(term, robot, "not always"))
        elif not _finite(written):
            found.not_exported.append(left_out(term, robot, "not finite"))
        else:
            _add(found, couplings, term, written, robot)
    gains = [drive.gain for drive in found.drives]
    for drive, joint in zip(found.drives, robot.joint_names, strict=True):
        drive.act()
        for name in ("damping", "frictionloss", "armature", "drag"):
            refuse_negative(joint, name, getattr(drive, name))
    for one in found.tendons:
        for name in ("damping", "frictionloss", "armature"):
            refuse_negative(" and ".join(robot.joint_names[j] for j in one.joints), name, getattr(one, name))
    for one in (t for t in couplings if len(t.joints) == 1):
        found.tendons.append(Tendon(one.joints, one.coef, one.stiffness / gains[one.joints[0]], 0.0, one.springlength))
    _divide(found, gains, robot)
    for kind in ("stiffness", "damping"):
        _couple(found, kind, [t for t in couplings if len(t.joints) == 2 and getattr(t, kind)], gains, robot)
    return found


def left_out(term: Term, robot: RobotModel, reason: str = "", note: str = "", by_hand: Sequence[str] = ()) -> Remark:
    """Return that a term is not in a file, or not all of it.

    Args:
        term: the term.
        robot: its robot.
        reason: key of the words, or "MJCF" or "URDF" where that has no element for it.
        note: the effect's own reason, in place of that.
        by_hand: elements to write by hand.
    """
    values = {"term": described(term, robot), "reason": reason, "note": note, "by_hand": list(by_hand)}
    return Remark("not exported", values)


def described(term: Term, robot: RobotModel) -> dict[str, Any]:
    """Return name, place and values of a term, these with their units."""
    site, values = term.site, term.parameters_by_name()
    prismatic = site.joint is not None and bool(robot.prismatic[site.joint])
    with_units = {name: [value, term.effect.unit(name, prismatic=prismatic)] for name, value in values.items()}
    return {"name": term.effect.words, "place": site.name(robot), "values": with_units}


def refuse_negative(joint: str, name: str, value: float) -> None:
    """Refuse a coefficient that would drive a joint.

    Raises:
        PhysicalError: it is negative.
    """
    if value < 0:
        raise PhysicalError(
            f"{joint}: {name} is {value:.4g}; a simulator would gain energy by a negative one, and no file holds it. "
            "Fit the term again, as identify does, or set its coefficients to zero"
        )


def _finite(written: Mjcf) -> bool:
    values = [v for attributes in written.values() for v in attributes.values() if not isinstance(v, str)]
    return all(math.isfinite(x) for v in values for x in (v if isinstance(v, tuple) else (v,)))


def _add(found: Gathered, couplings: list[Tendon], term: Term, written: Mjcf, robot: RobotModel) -> None:
    """Add one term's elements; what cannot be written becomes a remark, with the elements to write by hand."""
    by_hand = {e: a for e, a in written.items() if not _add_element(found, couplings, term, e, a, robot)}
    if not written or by_hand or term.effect.exported_in_part:
        elements = [element_text(e, a) for e, a in by_hand.items()]
        found.not_exported.append(left_out(term, robot, "MJCF", term.effect.export_note, elements))
    elif all(attributes.keys() <= _IN_TIME for attributes in written.values()):
        found.in_time.append(term)


def _add_element(
    found: Gathered, couplings: list[Tendon], term: Term, element: str, given: Mapping[str, Value], robot: RobotModel
) -> bool:
    """Add one element; say whether it could be."""
    site = term.site
    drives = found.drives if site.joint is None else [found.drives[site.joint]]
    if element == "general":
        return all([drive.add_actuator(given) for drive in drives])
    if element == "actuatorfrc":
        return all([drive.add_reading(given) for drive in drives])
    if element == "body":
        return _add_body(found, site.joint, given, robot)
    if element == "inertial" and site.body is not None:
        added = found.added.get(site.body, torch.zeros(10, dtype=torch.float64))
        found.added[site.body] = added + _about_origin(given)
        return True
    if element == "joint" and site.joint is not None:
        return drives[0].add_joint(given)
    if element == "fixed" and site.joint is not None:
        (found.tendons if term.effect.whole_robot else couplings).append(_tendon(site.joint, site.other, given))
        return True
    if element == "dcmotor" and "lugre" in given and site.joint is not None:
        # Without the motor's other constants there is no bristle; friction in motion remains.
        drives[0].frictionloss += _several(given["lugre"])[2]
    return False


def _several(value: Value) -> tuple[float, ...]:
    assert not isinstance(value, str)
    return value if isinstance(value, tuple) else (value,)


def _tendon(joint: int, other: int | None, given: Mapping[str, Value]) -> Tendon:
    coef = _several(given.get("coef", 1.0))
    joints = (joint,) if other is None else (joint, other)
    values = {name: _several(given.get(name, 0.0))[0] for name in ("stiffness", "damping", "frictionloss", "armature")}
    return Tendon(joints, coef, springlength=given.get("springlength", 0.0), **values)


def _add_body(found: Gathered, joint: int | None, given: Mapping[str, Value], robot: RobotModel) -> bool:
    """Shift and turn a joint's origin, or turn the base."""
    if "pos" in given and joint is not None:
        shift = torch.tensor(_several(given["pos"]), dtype=torch.float64)
        found.shifts[joint] = found.shifts.get(joint, torch.zeros_like(shift)) + shift
    if "quat" in given:
        w, *axis = _several(given["quat"])
        if joint is None:
            # A base is tilted about the two axes after that of gravity.
            axis = [axis[(k - int(robot.gravity.abs().argmax()) - 1) % 3] for k in range(3)]
        found.turns.setdefault(joint, []).append((w, *axis))
    return given.keys() <= {"pos", "quat"} and (joint is not None or "pos" not in given)


def _about_origin(given: Mapping[str, Value]) -> Tensor:
    """Return the inertial parameters (10,) of an <inertial>, about the origin of its body."""
    m, (x, y, z) = _several(given["mass"])[0], _several(given["pos"])
    xx, yy, zz, xy, xz, yz = _several(given["fullinertia"])
    central = (xx, xy, yy, xz, yz, zz)
    steiner = (y * y + z * z, -x * y, x * x + z * z, -x * z, -y * z, x * x + y * y)
    about = (i + m * s for i, s in zip(central, steiner, strict=True))
    return torch.tensor([m, m * x, m * y, m * z, *about], dtype=torch.float64)


def _divide(found: Gathered, gains: list[float], robot: RobotModel) -> None:
    """Divide what acts on both joints of a pair by the gain of their torques."""
    for k, one in enumerate(found.tendons):
        joint, *others = one.joints
        sizes = {name: getattr(one, name) / gains[joint] for name in ("damping", "frictionloss", "armature")}
        found.tendons[k] = replace(one, **sizes)
        for other in others:
            if gains[other] != gains[joint]:
                names = [robot.joint_names[j] for j in one.joints]
                found.not_exported.append(Remark("motor of two joints", {"joints": names}))


def _couple(found: Gathered, kind: str, couplings: list[Tendon], gains: list[float], robot: RobotModel) -> None:
    """Write what couples pairs of joints as tendons.

    A tendon also acts on each joint by the joint's own motion, besides the coupling. That part is subtracted from the
    joint's own stiffness or damping. Two terms that say the same from both sides are one tendon. If a joint has less
    damping than the coupling, both joints keep theirs and no tendon couples them: a joint of negative damping would
    gain energy.
    """
    crossed: dict[tuple[int, int], float] = {}
    for one in couplings:
        (joint, other), (own, cross), size = one.joints, one.coef, getattr(one, kind) / gains[one.joints[0]]
        crossed[joint, other] = crossed.get((joint, other), 0.0) + size * own * cross
        if kind == "stiffness":
            found.drives[joint].at_zero -= size * own * _several(one.springlength)[0]
    for (joint, other), forth in crossed.items():
        back = crossed.get((other, joint))
        if back is not None and other < joint:
            continue
        k = forth if back is None else 0.5 * (forth + back)
        names = [robot.joint_names[joint], robot.joint_names[other]]
        if kind == "damping" and min(found.drives[j].damping for j in (joint, other)) < abs(k):
            found.not_exported.append(Remark("coupling by speeds", {"joints": names, "damping": k}))
            continue
        for drive in (found.drives[joint], found.drives[other]):
            setattr(drive, kind, getattr(drive, kind) - abs(k))
        found.tendons.append(Tendon((joint, other), (1.0, math.copysign(1.0, k)), **{kind: abs(k)}))
        if back is None or abs(forth - back) > _SAME * abs(k):
            at_each = [forth, 0.0 if back is None else back]
            values = {"joints": names, "kind": kind, "size": k, "at_each": at_each}
            found.not_exported.append(Remark("coupling", values))
