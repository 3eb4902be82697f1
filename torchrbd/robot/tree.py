"""The kinematic tree: bodies numbered depth-first, fixed links merged into them, mimic joints resolved."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from torchrbd.errors import RobotError
from torchrbd.robot.description import Description, Joint
from torchrbd.robot.inertia import transform_inertia


@dataclass(frozen=True, eq=False)
class FoldedLink:
    """A link as part of a body.

    Attributes:
        pose: (4, 4) pose of the link in the body's frame.
        pi: (10,) inertial parameters about the link's own origin.
    """

    name: str
    pose: Tensor
    pi: Tensor


@dataclass(frozen=True, eq=False)
class Tree:
    """Bodies (one per moving joint) in depth-first order: the subtree of body `i` is `range(i, ends[i])`.

    The bodies' coordinates depend on the driving joints': `q_i = multipliers[i] * q[drivers[i]] + offsets[i]`.

    Attributes:
        moving: the joint that carries each body.
        driving: the joints that are free coordinates; the others mimic them.
        parents: parent body, -1 for the base.
        poses: (n_bodies, 4, 4) pose of a body's frame at `q_i = 0` in its parent body.
        folded: the links of each body, its own link first.
        pi: (10 * n_bodies,) inertial parameters of the bodies.
    """

    moving: tuple[Joint, ...]
    driving: tuple[Joint, ...]
    parents: tuple[int, ...]
    ends: tuple[int, ...]
    drivers: tuple[int, ...]
    multipliers: tuple[float, ...]
    offsets: tuple[float, ...]
    poses: Tensor
    folded: tuple[tuple[FoldedLink, ...], ...]
    pi: Tensor


def build_tree(description: Description) -> Tree:
    """Number the bodies, merge links behind fixed joints into them and resolve mimic joints.

    Raises:
        RobotError: the description is not one tree, has no moving joint, or a mimic joint follows a joint that does not
            move.
    """
    moving, parents, poses, folded = _walk(description)
    if not moving:
        raise RobotError(f"{description.source}: robot '{description.name}' has no moving joint: nothing has a torque")
    ends = list(range(1, len(moving) + 1))
    for body in reversed(range(len(moving))):
        if parents[body] >= 0:
            ends[parents[body]] = max(ends[parents[body]], ends[body])
    driving = [joint for joint in moving if joint.mimic is None]
    resolved = [_driver(joint, moving, description.source) for joint in moving]
    bodies = [torch.stack([transform_inertia(link.pi, link.pose) for link in links]).sum(0) for links in folded]
    return Tree(
        moving=tuple(moving),
        driving=tuple(driving),
        parents=tuple(parents),
        ends=tuple(ends),
        drivers=tuple(driving.index(driver) for driver, _, _ in resolved),
        multipliers=tuple(multiplier for _, multiplier, _ in resolved),
        offsets=tuple(offset for _, _, offset in resolved),
        poses=torch.stack(poses),
        folded=tuple(map(tuple, folded)),
        pi=torch.cat(bodies),
    )


def _walk(description: Description) -> tuple[list[Joint], list[int], list[Tensor], list[list[FoldedLink]]]:
    """Visit the links depth-first; return the joint, the parent body, the pose in it and the links of every body."""
    links = {link.name: link for link in description.links}
    below: dict[str, list[Joint]] = {name: [] for name in links}
    root = description.root()
    for joint in description.joints:
        below[joint.parent].append(joint)
    moving: list[Joint] = []
    parents: list[int] = []
    poses: list[Tensor] = []
    folded: list[list[FoldedLink]] = []
    identity = torch.eye(4, dtype=torch.float64)
    stack = [(joint, -1, identity) for joint in reversed(below[root])]
    while stack:
        joint, body, pose = stack.pop()
        pose = pose @ joint.pose
        if joint.kind != "fixed":
            moving.append(joint)
            parents.append(body)
            poses.append(pose)
            folded.append([])
            body, pose = len(moving) - 1, identity
        if body >= 0:
            folded[body].append(FoldedLink(joint.child, pose, links[joint.child].pi))
        stack.extend((child, body, pose) for child in reversed(below[joint.child]))
    return moving, parents, poses, folded


def parent_axes(description: Description, folded: Mapping[str, Sequence[FoldedLink]], joint: str) -> Tensor:
    """Return the axes of a joint's parent link in the body that the link is part of, (3, 3).

    Args:
        description: of the robot.
        folded: the links of each body.
        joint: its name.
    """
    parent = next(one.parent for one in description.joints if one.name == joint)
    poses = {link.name: link.pose for links in folded.values() for link in links}
    return poses[parent][:3, :3] if parent in poses else torch.eye(3, dtype=torch.float64)


def _driver(joint: Joint, moving: list[Joint], source: str) -> tuple[Joint, float, float]:
    """Follow a chain of mimic joints: `q_joint = multiplier * q_driver + offset`."""
    by_name = {other.name: other for other in moving}
    multiplier, offset, path = 1.0, 0.0, [joint.name]
    while (mimic := joint.mimic) is not None:
        if mimic.joint not in by_name:
            raise RobotError(
                f"{source}: joint '{joint.name}' mimics '{mimic.joint}', which is no moving joint of this robot; "
                "correct <mimic joint>, or remove the tag"
            )
        if mimic.joint in path:
            circle = " -> ".join([*path, mimic.joint])
            raise RobotError(f"{source}: mimic joints follow each other in a circle, {circle}; remove one <mimic>")
        offset += multiplier * mimic.offset
        multiplier *= mimic.multiplier
        joint = by_name[mimic.joint]
        path.append(joint.name)
    return joint, multiplier, offset
