"""Read MJCF through MuJoCo's own compiler.

MuJoCo computes kinematics and inertias, from geoms too. Only the given text is read: assets are left out, and
references to other files are errors. A joint's frame is at its anchor, in the body's axes at the joint's zero. A body
with several joints becomes several links, all but the last without mass.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import lxml.etree as etree
import numpy as np
import torch
from scipy.spatial.transform import Rotation
from torch import Tensor

from torchrbd.errors import OptionError, RobotError
from torchrbd.robot.description import Description, Joint, Link, Mimic
from torchrbd.robot.inertia import transform_inertia
from torchrbd.robot.urdf_text import urdf_text

_NO_PART = ("asset", "visual", "statistic", "keyframe", "sensor", "custom", "contact", "actuator", "tendon", "size")
_SHAPES = ("mesh", "hfield", "material", "texture", "skin")
_REPLACED = {"ball": "three hinges", "free": "nothing: the robot is identified on a fixed base"}


def read_mjcf(where: str, root: etree._Element) -> Description:
    """Read a robot from MJCF.

    Args:
        where: its name in messages.
        root: the text, parsed; it is modified.

    Raises:
        RobotError: MuJoCo rejects it, or it is not a tree of hinge and slide joints.
        OptionError: MuJoCo is not installed.
    """
    mujoco = _mujoco(where)
    _check(where, root)
    _leave_out(where, root)
    try:
        model = mujoco.MjModel.from_xml_string(etree.tostring(root, encoding="unicode"))
    except ValueError as error:
        words = " ".join(str(error).split())
        raise RobotError(f"{where}: MuJoCo {mujoco.__version__} does not take it: {words}") from None
    name = root.get("model") or "robot"
    found = Description(name, *_tree(where, model, mujoco), where, gravity=tuple(model.opt.gravity.tolist()))
    return Description(name, found.links, found.joints, where, urdf_text(found), found.gravity)


def _mujoco(where: str) -> Any:
    try:
        import mujoco
    except ImportError:
        raise OptionError(
            f"{where}: is MJCF, which MuJoCo reads, and MuJoCo is not installed: pip install mujoco "
            "(or torchrbd with its extra, mujoco)"
        ) from None
    return mujoco


def _check(where: str, root: etree._Element) -> None:
    """Reject what is not a tree of hinge and slide joints, or refers to other files."""
    for element in root.iter():
        place = f"{where}, line {element.sourceline}: <{element.tag}>"
        kind = "free" if element.tag == "freejoint" else element.get("type") if element.tag == "joint" else None
        if kind in _REPLACED:
            body = element.getparent()
            named = f" '{element.get('name')}'" if element.get("name") else ""
            at = "" if body is None else f" of body '{body.get('name') or '(without a name)'}'"
            raise RobotError(f"{place}: joint{named}{at} is a {kind} joint; replace it by {_REPLACED[kind]}")
        if element.tag in ("include", "attach", "extension", "plugin"):
            raise RobotError(
                f"{place} takes another file, and none is opened; give one file, as mujoco.mj_saveLastXML writes it"
            )
        if element.tag in ("replicate", "composite", "flexcomp"):
            raise RobotError(f"{place} makes many bodies of one; write them out, as mujoco.mj_saveLastXML does")
    for equality in root.findall("equality"):
        for one in equality:
            if one.tag != "joint" and one.get("active", "true") == "true":
                raise RobotError(
                    f"{where}, line {one.sourceline}: <{one.tag}> closes a loop or ties bodies; remove it, or set "
                    'active="false" to identify the tree without it'
                )


def _leave_out(where: str, root: etree._Element) -> None:
    """Remove what does not affect dynamics, above all shapes in files.

    Raises:
        RobotError: a moving body gets its mass from such a shape.
    """
    etree.strip_elements(root, *_NO_PART, with_tail=False)
    inferred = any(one.get("inertiafromgeom") == "true" for one in root.findall("compiler"))
    for geom in list(root.iter("geom")):
        body = geom.getparent()
        if body is None or (geom.get("mesh") is None and geom.get("hfield") is None):
            continue
        weightless = "0" in (geom.get("mass"), geom.get("density")) or not _moves(body)
        if not weightless and (inferred or body.find("inertial") is None):
            raise RobotError(
                f"{where}, line {geom.sourceline}: the mass of body '{body.get('name')}' would come from mesh "
                f"'{geom.get('mesh')}', and no mesh is opened; give the body an <inertial>"
                + (' and leave inertiafromgeom="true" out' if inferred else "")
            )
        body.remove(geom)
    for element in list(root.iter()):
        parent = element.getparent()
        if element.tag in _SHAPES and parent is not None:
            parent.remove(element)
        for name in _SHAPES:
            element.attrib.pop(name, None)
        if element.get("type") == "mesh":
            del element.attrib["type"]
    if (element := next((one for one in root.iter() if one.get("file") is not None), None)) is not None:
        raise RobotError(f'{where}: <{element.tag} file="{element.get("file")}">: no other file is opened; remove it')


def _moves(body: etree._Element) -> bool:
    """Return whether a body has a joint or an ancestor with one; defaults are not bodies."""
    return any(one.tag == "body" and one.find("joint") is not None for one in (body, *body.iterancestors()))


def _tree(where: str, model: Any, mujoco: Any) -> tuple[tuple[Link, ...], tuple[Joint, ...]]:
    """Return links and joints of a compiled model."""
    names = ["world", *(model.body(k).name or f"body{k}" for k in range(1, model.nbody))]
    anchor = np.zeros((model.nbody, 3))
    links, joints = [Link("world", torch.zeros(10, dtype=torch.float64))], list[Joint]()
    mimics = dict(_mimics(where, model, mujoco))
    for body in range(1, model.nbody):
        above = int(model.body_parentid[body])
        parent, pose = names[above], _shifted(-anchor[above]) @ _pose(model.body_pos[body], model.body_quat[body])
        own = range(int(model.body_jntadr[body]), int(model.body_jntadr[body] + model.body_jntnum[body]))
        for k in own:
            child = names[body] if k == own[-1] else f"{names[body]}_{k - own[0] + 1}"
            if not model.joint(k).name:
                raise RobotError(f"{where}: a joint of body '{names[body]}' has no name; give it one")
            pose = pose @ _shifted(model.jnt_pos[k] - anchor[body])
            joints.append(_joint(model, mujoco, k, parent, child, pose, mimics.get(k)))
            links += [Link(child, torch.zeros(10, dtype=torch.float64))] if child != names[body] else []
            parent, pose, anchor[body] = child, torch.eye(4, dtype=torch.float64), model.jnt_pos[k]
        if not own:
            joints.append(Joint(f"{names[body]}_fixed", "fixed", parent, names[body], pose, torch.eye(3)[2].double()))
        pi = torch.zeros(10, dtype=torch.float64)
        pi[0], pi[[4, 6, 9]] = float(model.body_mass[body]), torch.from_numpy(model.body_inertia[body].copy())
        at = _shifted(-anchor[body]) @ _pose(model.body_ipos[body], model.body_iquat[body])
        links.append(Link(names[body], transform_inertia(pi, at)))
    return tuple(links), tuple(joints)


def _joint(model: Any, mujoco: Any, k: int, parent: str, child: str, pose: Tensor, mimic: Mimic | None) -> Joint:
    """Return joint k; its frame is at ``pose`` in the parent's at MuJoCo's reference position."""
    slides = model.jnt_type[k] == mujoco.mjtJoint.mjJNT_SLIDE
    axis, at = np.array(model.jnt_axis[k]), int(model.jnt_dofadr[k])
    reference = float(model.qpos0[model.jnt_qposadr[k]])
    back = _shifted(-reference * axis)
    if not slides:
        back = torch.eye(4, dtype=torch.float64)
        back[:3, :3] = torch.from_numpy(Rotation.from_rotvec(-reference * axis).as_matrix())
    low, high = model.jnt_range[k].tolist() if model.jnt_limited[k] else (-np.inf, np.inf)
    effort = float(model.jnt_actfrcrange[k][1]) if model.jnt_actfrclimited[k] else np.inf
    return Joint(
        name=model.joint(k).name,
        kind="prismatic" if slides else "revolute",
        parent=parent,
        child=child,
        pose=pose @ back,
        axis=torch.from_numpy(axis),
        damping=float(np.ravel(model.dof_damping[at])[0]),
        friction=float(model.dof_frictionloss[at]),
        armature=float(model.dof_armature[at]),
        stiffness=float(np.ravel(model.jnt_stiffness[k])[0]),
        rest=float(model.qpos_spring[model.jnt_qposadr[k]]),
        lower=low,
        upper=high,
        effort=effort,
        mimic=mimic,
    )


def _mimics(where: str, model: Any, mujoco: Any) -> Iterator[tuple[int, Mimic]]:
    """Yield joints that an equality constraint couples to others: y - y0 = c0 + c1 (x - x0)."""
    for k in range(model.neq):
        if model.eq_type[k] != mujoco.mjtEq.mjEQ_JOINT or not model.eq_active0[k]:
            continue
        first, second = int(model.eq_obj1id[k]), int(model.eq_obj2id[k])
        constant, linear, *more = model.eq_data[k][:5].tolist()
        if second < 0 or any(more):
            raise RobotError(
                f"{where}: the equality at joint '{model.joint(first).name}' is no straight line of another joint; "
                "remove it"
            )
        y, x = (float(model.qpos0[model.jnt_qposadr[j]]) for j in (first, second))
        yield first, Mimic(model.joint(second).name, linear, y + constant - linear * x)


def _pose(position: np.ndarray, quaternion: np.ndarray) -> Tensor:
    """Return a (4, 4) pose; MuJoCo's quaternions begin with w."""
    pose = _shifted(position)
    w, *axis = quaternion.tolist()
    pose[:3, :3] = torch.from_numpy(Rotation.from_quat([*axis, w]).as_matrix())
    return pose


def _shifted(position: np.ndarray) -> Tensor:
    pose = torch.eye(4, dtype=torch.float64)
    pose[:3, 3] = torch.from_numpy(np.array(position, dtype=np.float64))
    return pose
