"""What MuJoCo makes of an exported file: the torques of given motions, by its own inverse dynamics."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np
from lxml import etree

from torchrbd.errors import InputError, OptionError
from torchrbd.robot import RobotModel
from torchrbd.robot.tree import build_tree

# Of a URDF: nothing is changed but bodies without mass, which MuJoCo would refuse.
_COMPILER = {"balanceinertia": "false", "fusestatic": "false", "boundmass": "1e-12", "boundinertia": "1e-12"}


def replayed(file: bytes, robot: RobotModel, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
    """Return the torques that the actuators of a file must be asked for, by MuJoCo.

    They are mj_inverse's, those at mimic joints brought to the joints that these follow, through the gain and the
    offset of the joint's actuator. Joint limits and contacts are off: they are no part of the dynamics that are
    compared. How actuators act in time, their lags and delays, is not in inverse dynamics.

    Args:
        file: MJCF, or URDF, whose massless links MuJoCo is given the least mass for.
        robot: that was written.
        q, qd, qdd: (N, n_dof) [rad, m] and per second, per second squared.

    Returns:
        (N, n_dof) [N m] or [N], joints in the robot's order.

    Raises:
        OptionError: MuJoCo is not installed.
        InputError: MuJoCo does not take the file.
    """
    mujoco = _mujoco()
    machine = _compiled(mujoco, file, robot)
    machine.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_LIMIT
    tree, data = build_tree(robot.description), mujoco.MjData(machine)
    at = [machine.jnt_dofadr[machine.joint(joint.name).id] for joint in tree.moving]
    follow = np.zeros((len(at), robot.n_dof))
    follow[range(len(at)), tree.drivers] = tree.multipliers
    forces = np.empty(q.shape)
    # An encoder's zero that is off is in <joint ref>; what follows a joint goes by where it is.
    zero = machine.qpos0[[at[robot.joint_bodies[j]] for j in range(robot.n_dof)]]
    positions = (q - zero) @ follow.T + np.array(tree.offsets)
    positions[:, list(robot.joint_bodies)] = q
    for k, row in enumerate(zip(positions, qd @ follow.T, qdd @ follow.T, strict=True)):
        data.qpos[at], data.qvel[at], data.qacc[at] = row
        mujoco.mj_inverse(machine, data)
        forces[k] = data.qfrc_inverse[at] @ follow
    gain, bias = np.ones(robot.n_dof), np.zeros(robot.n_dof)
    for k in range(machine.nu):
        joint = robot.joint_names.index(machine.joint(machine.actuator_trnid[k, 0]).name)
        gain[joint], bias[joint] = machine.actuator_gainprm[k, 0], machine.actuator_biasprm[k, 0]
    return (forces - bias) / gain


def _mujoco() -> ModuleType:
    try:
        import mujoco
    except ImportError:
        raise OptionError("MuJoCo is not installed: pip install mujoco (or torchrbd with its extra, mujoco)") from None
    return mujoco


def _compiled(mujoco: ModuleType, file: bytes, robot: RobotModel) -> Any:
    """Return MuJoCo's model of a file."""
    root, remedy = etree.fromstring(file), ""
    if root.tag == "robot":
        # Meshes would be searched for, odd limits be written of to a log in the user's folder, and what stands still
        # weighs on no joint, however odd its inertia.
        etree.strip_elements(root, "visual", "collision", "limit", "mujoco", with_tail=False)
        carried = {link.name for links in robot.folded.values() for link in links}
        for inertial in root.findall("link/inertial"):
            link = inertial.getparent()
            if link is not None and link.get("name") not in carried:
                link.remove(inertial)
        etree.SubElement(etree.SubElement(root, "mujoco"), "compiler", _COMPILER)
        remedy = "; correct the link in the URDF, or write MJCF, in which a moving link has all that is fixed to it"
    try:
        return mujoco.MjModel.from_xml_string(etree.tostring(root, encoding="unicode"))
    except ValueError as error:
        words = " ".join(str(error).split())
        raise InputError(f"MuJoCo {mujoco.__version__} does not take the file ({words}){remedy}") from None
