"""A robot description in any format: links, joints, and how they are connected."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from torchrbd.errors import RobotError


@dataclass(frozen=True, eq=False)
class Link:
    """A rigid link.

    Attributes:
        pi: (10,) inertial parameters about the link's origin, in its axes [kg, kg m, kg m^2].
    """

    name: str
    pi: Tensor


@dataclass(frozen=True, eq=False)
class Mimic:
    """Coupling of a joint to another one: `q = multiplier * q_joint + offset`."""

    joint: str
    multiplier: float
    offset: float


@dataclass(frozen=True, eq=False)
class Joint:
    """A joint between two links.

    Attributes:
        kind: "revolute" (with or without limits), "prismatic" or "fixed".
        pose: (4, 4) pose of the joint's frame in the parent link.
        axis: (3,) unit axis in the joint's frame.
        damping: viscous friction [N m s/rad, N s/m].
        friction: Coulomb friction [N m, N].
        armature: inertia of the rotor at the joint, behind the gear [kg m^2, kg].
        stiffness, rest: of a spring in the joint [N m/rad, N/m], and its rest position [rad, m].
        lower, upper, velocity, effort: limits, infinite where not given [rad, rad/s, N m; m, m/s, N].
    """

    name: str
    kind: str
    parent: str
    child: str
    pose: Tensor
    axis: Tensor
    damping: float = 0.0
    friction: float = 0.0
    armature: float = 0.0
    stiffness: float = 0.0
    rest: float = 0.0
    lower: float = -float("inf")
    upper: float = float("inf")
    velocity: float = float("inf")
    effort: float = float("inf")
    mimic: Mimic | None = None


@dataclass(frozen=True, eq=False)
class Description:
    """A robot as described.

    Attributes:
        source: its origin, as in error messages.
        urdf: the URDF text, or an equivalent one as far as URDF allows; None for a chain.
        gravity: (3,) in the base's axes [m/s^2], if the description gives it.
    """

    name: str
    links: tuple[Link, ...]
    joints: tuple[Joint, ...]
    source: str
    urdf: bytes | None = None
    gravity: tuple[float, ...] | None = None

    def root(self) -> str:
        """Return the root link's name.

        Raises:
            RobotError: links and joints do not form one tree, or a name is not unique.
        """
        for what, names in (("link", [x.name for x in self.links]), ("joint", [x.name for x in self.joints])):
            if twice := sorted({name for name in names if names.count(name) > 1}):
                raise RobotError(f"{self.source}: {what} name '{twice[0]}' is used more than once; rename all but one")
        known = {link.name for link in self.links}
        above: dict[str, Joint] = {}
        for joint in self.joints:
            for role, link in (("parent", joint.parent), ("child", joint.child)):
                if link not in known:
                    raise RobotError(
                        f"{self.source}: joint '{joint.name}' has {role} link '{link}', which does not exist; "
                        "add the link, or correct its name"
                    )
            if joint.child in above:
                raise RobotError(
                    f"{self.source}: link '{joint.child}' has two parents, through joints '{above[joint.child].name}' "
                    f"and '{joint.name}': closed loops are not supported; remove one of the joints"
                )
            above[joint.child] = joint
        return self._single_root(above)

    def _single_root(self, above: dict[str, Joint]) -> str:
        """Return the one link without a parent joint, if every other link can be reached from it."""
        roots = [link.name for link in self.links if link.name not in above]
        if len(roots) > 1:
            raise RobotError(
                f"{self.source}: one tree expected, but {len(roots)} links have no parent: {', '.join(roots)}; "
                "connect them with joints or remove them"
            )
        reached = set(roots)
        for link in self.links:
            path = []
            while (name := link.name if not path else above[path[-1]].parent) not in reached:
                if name in path:
                    raise RobotError(
                        f"{self.source}: links {', '.join(path[path.index(name) :])} form a closed loop; "
                        f"remove joint '{above[name].name}'"
                    )
                path.append(name)
            reached.update(path)
        if not roots:
            raise RobotError(f"{self.source}: no links")
        return roots[0]
