"""Exchange of kinematics with pytorch-kinematics' chains."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import torch
from pytorch_kinematics import Chain, Transform3d
from pytorch_kinematics import frame as pk_frame
from torch import Tensor

from torchrbd.errors import RobotError
from torchrbd.robot.description import Description, Joint, Link


def read_chain(chain: Chain, inertials: Mapping[str, Tensor]) -> Description:
    """Describe a robot by a chain and its links' inertial parameters.

    Args:
        chain: the kinematics.
        inertials: (10,) inertial parameters about the link's origin by link name; other links are massless.

    Raises:
        RobotError: an inertial names no link of the chain, or does not have 10 numbers.
    """
    source = "pytorch-kinematics chain"
    names: list[str] = []
    joints: list[Joint] = []
    root: Any = chain.find_frame(chain.get_frame_names(exclude_fixed=False)[0])
    stack: list[tuple[Any, str | None, Tensor]] = [(root, None, torch.eye(4, dtype=torch.float64))]
    while stack:
        frame, parent, pose = stack.pop()
        name = frame.link.name or frame.name
        pose = pose @ _matrix(frame.link.offset) @ _matrix(frame.joint.offset)
        names.append(name)
        if parent is not None:
            joints.append(_read_joint(frame.joint, parent, name, pose))
            pose = torch.eye(4, dtype=torch.float64)
        stack.extend((child, name, pose) for child in reversed(frame.children))
    if unknown := [name for name in inertials if name not in names]:
        raise RobotError(f"{source}: inertials name link '{unknown[0]}', which is not in the chain: {', '.join(names)}")
    return Description("chain", tuple(_read_link(source, name, inertials) for name in names), tuple(joints), source)


def write_chain(description: Description, dtype: torch.dtype, device: torch.device | str) -> Chain:
    """Build a chain with the described offsets and axes, in the given dtype; a mimic joint becomes a free joint."""
    root = description.root()
    frames = {link.name: pk_frame.Frame(link.name, pk_frame.Link(link.name)) for link in description.links}
    for joint in description.joints:
        child = frames[joint.child]
        child.joint = pk_frame.Joint(
            joint.name,
            offset=Transform3d(matrix=joint.pose.to(dtype=dtype, device=device)),
            joint_type=joint.kind,
            axis=joint.axis,
            dtype=dtype,
            device=str(device),
            limits=(joint.lower, joint.upper),
            velocity_limits=(-joint.velocity, joint.velocity),
            effort_limits=(-joint.effort, joint.effort),
        )
        frames[joint.parent].add_child(child)
    return Chain(frames[root].to(dtype=dtype, device=device), dtype=dtype, device=str(device))


def _matrix(offset: Transform3d | None) -> Tensor:
    """Return an offset as a (4, 4) pose; its rotation is made orthogonal, which float32 only is nearly."""
    if offset is None:
        return torch.eye(4, dtype=torch.float64)
    pose = offset.get_matrix()[0].detach().to(dtype=torch.float64, device="cpu")
    left, _, right = torch.linalg.svd(pose[:3, :3])
    pose[:3, :3] = left @ right
    return pose


def _read_joint(joint: Any, parent: str, child: str, pose: Tensor) -> Joint:
    """Describe a chain's joint."""
    axis = joint.axis.detach().to(dtype=torch.float64, device="cpu")
    limits = zip(("lower", "upper"), joint.limits or (), strict=False)
    sizes = (("velocity", joint.velocity_limits), ("effort", joint.effort_limits))
    given = {**dict(limits), **{name: pair[1] for name, pair in sizes if pair is not None}}
    given = {name: float(value) for name, value in given.items() if value is not None}
    described = Joint(joint.name, joint.joint_type, parent, child, pose, axis / axis.norm())
    return replace(described, **given)


def _read_link(source: str, name: str, inertials: Mapping[str, Tensor]) -> Link:
    """Describe a link; one without inertial parameters is massless."""
    pi = torch.as_tensor(inertials.get(name, torch.zeros(10)), dtype=torch.float64)
    if pi.shape != (10,):
        raise RobotError(f"{source}: inertial parameters of link '{name}' have shape {tuple(pi.shape)}, expected (10,)")
    return Link(name, pi)
