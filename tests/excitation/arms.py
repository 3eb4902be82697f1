"""A small arm with every limit, and what Pinocchio says of it."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

_LINKS = (
    # origin, axis, centre of mass, mass, inertia (xx, yy, zz), range, speed, torque, damping, friction
    ("0 0 0.1", "0 0 1", "0 0.01 0.1", 6.0, (0.05, 0.05, 0.03), 2.5, 2.0, 30.0, 0.6, 0.4),
    ("0 0 0.2", "0 1 0", "0.01 0 0.2", 5.0, (0.09, 0.09, 0.01), 1.4, 2.0, 60.0, 0.8, 0.5),
    ("0 0 0.45", "0 1 0", "0.02 0 0.18", 3.0, (0.05, 0.05, 0.006), 2.2, 2.5, 20.0, 0.3, 0.2),
)


def arm_urdf(*, limits: bool = True, friction: bool = True) -> str:
    """Return an arm of three revolute joints with a tool fixed to its last link."""
    tags = ['<link name="base"/>', '<link name="tool"/>']
    for k, (origin, axis, centre, mass, (xx, yy, zz), reach, speed, torque, viscous, coulomb) in enumerate(_LINKS, 1):
        parent = "base" if k == 1 else f"link{k - 1}"
        limit = f'<limit lower="{-reach}" upper="{reach}" velocity="{speed}" effort="{torque}"/>' if limits else ""
        dynamics = f'<dynamics damping="{viscous}" friction="{coulomb}"/>' if friction else ""
        tags.append(
            f'<link name="link{k}"><inertial><origin xyz="{centre}"/><mass value="{mass}"/>'
            f'<inertia ixx="{xx}" iyy="{yy}" izz="{zz}" ixy="0" ixz="0" iyz="0"/></inertial></link>'
            f'<joint name="joint{k}" type="{"revolute" if limits else "continuous"}"><parent link="{parent}"/>'
            f'<child link="link{k}"/><origin xyz="{origin}"/><axis xyz="{axis}"/>{limit}'
            f"{dynamics}</joint>"
        )
    tags.append(
        '<joint name="mount" type="fixed"><parent link="link3"/><child link="tool"/><origin xyz="0 0 0.4"/></joint>'
    )
    return f'<robot name="arm">{"".join(tags)}</robot>'


def pinocchio_torque(urdf: str, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
    """Return torques (N, n) of the rigid body and of the URDF's friction, joints in Pinocchio's order."""
    model = pin.buildModelFromXML(urdf)
    data = model.createData()
    rigid = np.stack([pin.rnea(model, data, *row).copy() for row in zip(q, qd, qdd, strict=True)])
    return rigid + np.array([one[8] for one in _LINKS]) * qd + np.array([one[9] for one in _LINKS]) * np.sign(qd)


def pinocchio_regressor(urdf: str, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
    """Return the regressor (N, n, 10 n) of the inverse dynamics."""
    model = pin.buildModelFromXML(urdf)
    data = model.createData()
    rows = zip(q, qd, qdd, strict=True)
    return np.stack([pin.computeJointTorqueRegressor(model, data, *row).copy() for row in rows])


def pinocchio_origins(urdf: str, q: np.ndarray, links: tuple[str, ...]) -> np.ndarray:
    """Return where the origins of links are, (N, links, 3)."""
    model = pin.buildModelFromXML(urdf)
    data, found = model.createData(), []
    for row in q:
        pin.framesForwardKinematics(model, data, row)
        found.append([data.oMf[model.getFrameId(name)].translation.copy() for name in links])
    return np.array(found)
