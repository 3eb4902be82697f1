"""Known loads: what a user says hangs on the robot while a recording was made."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from torchrbd.errors import OptionError
from torchrbd.parameters import PARAMETERS_PER_BODY
from torchrbd.robot import RobotModel, from_pseudo_inertia

# More than any robot carries [kg], and farther out [m].
_HEAVIEST, _FURTHEST = 1e6, 1e3


@dataclass(frozen=True)
class Payload:
    """A known load on the robot in one recording: mass [kg] and centre of mass [m] in the frame of ``link``."""

    recording: str
    mass: float
    centre: tuple[float, float, float]
    link: str | None = None

    @classmethod
    def parse(cls, text: str) -> Payload:
        """Read ``FILE=kg,x,y,z`` or ``FILE=kg,x,y,z@LINK``."""
        name, _, numbers = text.rpartition("=")
        numbers, _, link = numbers.partition("@")
        try:
            mass, x, y, z = (float(part) for part in numbers.split(","))
        except ValueError:
            raise OptionError(f"payload '{text}': expected FILE=kg,x,y,z or FILE=kg,x,y,z@LINK") from None
        if not name or not 0.0 < mass <= _HEAVIEST or not math.hypot(x, y, z) <= _FURTHEST:
            raise OptionError(
                f"payload '{text}': expected FILE=kg,x,y,z with a mass above zero, at most {_HEAVIEST:g} kg, "
                f"within {_FURTHEST:g} m"
            )
        return cls(Path(name).name, mass, (x, y, z), link or None)


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
