"""Known loads: what a user says hangs on the robot while a recording was made."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from torchrbd.errors import OptionError
from torchrbd.options import Payload
from torchrbd.parameters import PARAMETERS_PER_BODY
from torchrbd.robot import RobotModel, from_pseudo_inertia


def payload_parameters(robot: RobotModel, recordings: Sequence[str], payloads: Sequence[Payload]) -> dict[str, Tensor]:
    """Return what the loads add to the inertial parameters, (n_params,) by name of the recording: point masses.

    Raises:
        OptionError: a load is of no recording here, or on no moving link.
    """
    where = {link.name: (body, link.pose) for body, links in robot.folded.items() for link in links}
    found: dict[str, Tensor] = {}
    for load in payloads:
        if load.recording not in recordings:
            raise OptionError(
                f"payload for '{load.recording}', which is no recording here; there are: {', '.join(recordings)}"
            )
        link = load.link or _only_leaf(robot, load)
        if link not in where:
            raise OptionError(
                f"payload on '{link}', which is no moving link of robot '{robot.name}'; it has: {', '.join(where)}"
            )
        body, pose = where[link]
        point = pose @ torch.tensor((*load.centre, 1.0), dtype=torch.float64)
        own = from_pseudo_inertia(load.mass * torch.outer(point, point))
        first = PARAMETERS_PER_BODY * robot.body_names.index(body)
        pi = found.setdefault(load.recording, torch.zeros(robot.n_params, dtype=torch.float64))
        pi[first : first + PARAMETERS_PER_BODY] += own
    return found


def _only_leaf(robot: RobotModel, load: Payload) -> str:
    """Return the last link of a chain; on a branched robot the link has to be named."""
    first, *others = robot.leaves
    if others:
        raise OptionError(
            f"payload of '{load.recording}': robot '{robot.name}' has several ends; "
            f"add @LINK to say on which of them: {', '.join(robot.leaves)}"
        )
    return first
