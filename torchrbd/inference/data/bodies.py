"""What the description says of bodies and base, before any recording is read: masses, and a base that stands still."""

from __future__ import annotations

from torchrbd.display import Remark
from torchrbd.errors import RobotError
from torchrbd.parameters import PARAMETERS_PER_BODY
from torchrbd.robot import RobotModel

# The name of a root link that says that a robot is fixed to the world, as in MoveIt, Gazebo and Drake.
_WORLD = "world"


def check_masses(robot: RobotModel) -> None:
    """Refuse a robot none of whose bodies has a mass: there is nothing for a fit to start from.

    Raises:
        RobotError: names the links.
    """
    if not bool((robot.pi[::PARAMETERS_PER_BODY] > 0).any()):
        raise RobotError(
            f"{robot.description.source}: no moving link of robot '{robot.name}' has a mass: "
            f"{', '.join(robot.body_names)}; give each an <inertial> with a rough mass, centre of mass and inertia, "
            "e.g. from its data sheet or its CAD volume: the fit starts from these"
        )


def fixed_base(robot: RobotModel) -> tuple[Remark, ...]:
    """Return the warning that a heavy base with several limbs is taken as fixed to the world; none for other robots.

    A root link without mass that is called "world" says that the base is fixed.
    """
    description = robot.description
    moving = {link.name for links in robot.folded.values() for link in links}
    base = [link for link in description.links if link.name not in moving]
    names, root = {link.name for link in base}, description.root()
    limbs = [joint.child for joint in description.joints if joint.name in robot.joint_names and joint.parent in names]
    heaviest = max(base, key=lambda link: float(link.pi[0]))
    if len(limbs) < 2 or not float(heaviest.pi[0]) > 0 or (root == _WORLD and heaviest.name != root):
        return ()
    values = {"base": heaviest.name, "limbs": len(limbs), "world": _WORLD, "root": root}
    return (Remark("base taken as fixed", values),)
