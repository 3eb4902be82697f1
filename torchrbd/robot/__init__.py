"""Rigid-body dynamics: reading robots, kinematics, inverse and forward dynamics, the regressor."""

from torchrbd.robot.gravity import STANDARD_GRAVITY
from torchrbd.robot.inertia import PARAMETERS, from_pseudo_inertia, inertia_matrix, pseudo_inertia, transform_inertia
from torchrbd.robot.model import RobotModel
from torchrbd.robot.origins import joint_origins, with_moved_origins
from torchrbd.robot.tree import FoldedLink

__all__ = [
    "PARAMETERS",
    "STANDARD_GRAVITY",
    "FoldedLink",
    "RobotModel",
    "from_pseudo_inertia",
    "inertia_matrix",
    "joint_origins",
    "pseudo_inertia",
    "transform_inertia",
    "with_moved_origins",
]
