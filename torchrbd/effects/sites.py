"""Where and when an effect may act."""

from __future__ import annotations

import math
from dataclasses import dataclass

from torchrbd.robot import RobotModel
from torchrbd.robot.inertia import PARAMETERS


@dataclass(frozen=True)
class Window:
    """A window of time in one recording, in seconds from its start; the end is excluded."""

    recording: str
    start_s: float = -math.inf
    end_s: float = math.inf


@dataclass(frozen=True)
class Site:
    """Where an effect acts, by index in the robot; None for what does not apply.

    Attributes:
        joint: whose torque it adds to.
        other: another joint, on whose motion it depends; a whole-robot effect acts on both.
        body: on which it acts.
        window: when it acts; always, if None.
        recordings: names of those in which it acts; all, if None.
    """

    joint: int | None = None
    other: int | None = None
    body: int | None = None
    window: Window | None = None
    recordings: tuple[str, ...] | None = None

    @property
    def always(self) -> bool:
        """Whether it acts in all recordings, from start to end."""
        return self.window is None and self.recordings is None

    def name(self, robot: RobotModel) -> str:
        """Return the place by the robot's names: ``joint3``, ``joint3_joint2``, ``link5``, or "robot" for all of it.

        Recordings follow if it acts in some only: "joint3 in warm.csv, hot.csv".
        """
        parts = [robot.joint_names[j] for j in (self.joint, self.other) if j is not None]
        parts += [robot.body_names[self.body]] if self.body is not None else []
        place = "_".join(parts) or "robot"
        return place if self.recordings is None else f"{place} in {', '.join(self.recordings)}"


def carrier(robot: RobotModel, joint: int) -> int | None:
    """Return the nearest joint that moves another one; None for the first joint."""
    own = len(PARAMETERS) * robot.joint_bodies[joint]
    moving = [k for k in range(robot.n_dof) if k != joint and own in robot.columns(k)]
    return min(moving, key=lambda k: len(robot.columns(k)), default=None)
