"""Wrong geometry that is too far off for a mistake in a robot's description: links of another variant."""

from __future__ import annotations

import math

import torch

from torchrbd.diagnosis.decisions import DECISIONS
from torchrbd.diagnosis.results import Finding, Variant
from torchrbd.effects import effect
from torchrbd.robot import RobotModel, joint_origins


def another_variant(finding: Finding, robot: RobotModel) -> Variant | None:
    """Return how far a joint's origin is off, if it is certainly farther off than descriptions are.

    That is by three times the prior standard deviation of its origin, nearer to its parent link or farther from it.

    Args:
        finding: of any effect.
        robot: as described.

    Returns:
        None otherwise.
    """
    geometry = effect(finding.effect)
    if not geometry.moves_origin:
        return None
    (name,) = finding.joints
    origin = joint_origins(robot)[robot.joint_names.index(name)]
    numbers = [finding.parameters[axis] for axis in "xyz"]
    # What no torque feels is not a number: it stays as it is described.
    shift, std = (torch.nan_to_num(origin.new_tensor([getattr(q, k) for q in numbers])) for k in ("value", "std"))
    given, found = float(origin.norm()), float((origin + shift).norm())
    error = math.sqrt(float(((origin + shift) / max(found, 1e-300) * std).square().sum()))
    if abs(found - given) <= DECISIONS.other_variant * max(error, *geometry.prior.std[:3]):
        return None
    parent = next(joint.parent for joint in robot.description.joints if joint.name == name)
    return Variant(parent, found, given)
