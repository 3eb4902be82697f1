"""What a designed motion is, and how much of its limits it uses."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import torch
from torch import Tensor

from torchrbd.display import Remark, brief
from torchrbd.excitation.conditioning import ConditionNumbers
from torchrbd.excitation.constraints import Constraints
from torchrbd.excitation.fourier import FourierMotion
from torchrbd.excitation.limits import Limits
from torchrbd.robot import RobotModel


@dataclass(frozen=True)
class JointUse:
    """What a motion makes of one joint.

    Attributes:
        joint: which.
        low, high: between which positions it moves [rad or m].
        speed, acceleration, torque: the greatest [rad/s or m/s, per s, N m or N].
        range_used, speed_used, torque_used: greatest parts of what half the range, the speed (at the share that was
            asked for) and the torque may be, margin included; NaN where there is no limit.
    """

    joint: str
    low: float
    high: float
    speed: float
    acceleration: float
    torque: float
    range_used: float
    speed_used: float
    torque_used: float


@dataclass(frozen=True)
class Separation:
    """Two effects that a diagnosis could not distinguish, and the expected evidence of the motion.

    Attributes:
        one, other: in words, with their places.
        log_bayes_factor: expected for the true one of the two, the smaller of both cases [nats].
        probability: of the true one before, given that it is one of the two, the smaller of both.
        probability_after: expected.
    """

    one: str
    other: str
    log_bayes_factor: float
    probability: float
    probability_after: float


@dataclass(frozen=True, eq=False, repr=False)
class Excitation:
    """A motion to record next.

    Attributes:
        robot: for which.
        motion: one period of it.
        periods: how often it repeats.
        limits: that it keeps.
        condition: condition numbers of the regressor that it makes.
        uses: joint by joint, what it uses of its limits.
        clearance: least distance of links' origins to the box [m]; NaN without one.
        separations: pairs of effects that a diagnosis has left open, and how well it distinguishes them.
        notes: what a user should know of it.
    """

    robot: RobotModel
    motion: FourierMotion
    periods: int
    limits: Limits
    condition: ConditionNumbers
    uses: tuple[JointUse, ...]
    clearance: float
    separations: tuple[Separation, ...] = ()
    notes: tuple[Remark, ...] = field(default=())

    @property
    def duration_s(self) -> float:
        """Of all periods [s]."""
        return self.periods * self.motion.period_s

    def states(self, rate_hz: float = 100.0) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Return t (N,), and q, qd, qdd (N, n) at so many samples a second; the first and the last are at rest."""
        t = torch.arange(math.ceil(self.duration_s * rate_hz - 1e-9) + 1, dtype=torch.float64) / rate_hz
        return t, *self.motion.states(t.clamp_max(self.duration_s))

    def __repr__(self) -> str:
        return brief(
            self,
            robot=self.robot.name,
            duration_s=self.duration_s,
            condition=float(self.condition.scaled),
            separations=len(self.separations),
        )


def joint_uses(constraints: Constraints, motion: FourierMotion, t: Tensor) -> tuple[JointUse, ...]:
    """Return what a motion makes of each joint at times t (N,)."""
    limits, (q, qd, qdd) = constraints.limits, motion.states(t)
    greatest = torch.stack((qd, qdd, constraints.torque(t, q, qd, qdd))).abs().amax(1)
    half = 0.5 * (limits.upper - limits.lower)
    stroke = (q - 0.5 * (limits.lower + limits.upper)).abs().amax(0) / half
    used = torch.stack((stroke, greatest[0] / limits.velocity, greatest[2] / limits.effort))
    limited = torch.stack((limits.moves, limits.moves, limits.effort.isfinite()))
    used = torch.where(limited, used, torch.nan)
    rows = torch.cat((torch.stack((q.amin(0), q.amax(0))), greatest, used)).T.tolist()
    return tuple(JointUse(name, *row) for name, row in zip(constraints.robot.joint_names, rows, strict=True))


def clearance(constraints: Constraints, q: Tensor) -> float:
    """Return the least distance of links' origins to the box on the way q (N, n) [m]; NaN without a box."""
    if not constraints.points:
        return float("nan")
    p, box = constraints.positions(q), constraints.limits.box
    return float(torch.minimum(p - box[:, 0], box[:, 1] - p).min())
