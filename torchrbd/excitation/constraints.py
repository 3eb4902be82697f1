"""Whether a motion keeps its limits, as functions of its states that an optimiser can follow.

How much of a limit is used, |q - middle| / half, |qd| / fastest, |tau| / strongest, or 1 + (p - end) / length of a
point p at a box's end, is at most one. Of all samples of one limit the greatest counts, as its smooth upper bound

    max_i u_i <= (1 / rho) log sum_i exp(rho u_i) <= max_i u_i + log(N) / rho

Source: Kreisselmeier and Steinhauser, "Systematic control design by optimizing a vector performance index", IFAC
    Symposium on CAD of Control Systems, 1979.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from torchrbd.excitation.limits import AXES, Limits
from torchrbd.robot import RobotModel

Torque = Callable[[Tensor, Tensor, Tensor, Tensor], Tensor]
"""Torque (N, n) at states q, qd, qdd (N, n) and times (N,)."""

_RHO = 200.0
# A point that is so far outside its box [m] is as bad as a joint that uses twice its limit; room that is left [m].
_LENGTH, _ROOM = 0.25, 1e-3
# Postures at which it is found which points move.
_POSTURES, _STILL = 64, 1e-9


@dataclass(frozen=True)
class Point:
    """A link's origin: in which body, and where in it (3,) [m]."""

    link: str
    body: int
    place: Tensor


class Constraints:
    """The limits of a motion of one robot.

    Args:
        robot: the robot.
        limits: to be kept.
        torque: what the actuators supply.

    Attributes:
        robot, limits, torque: as given.
        labels: what each limit is, in words.
        points: origins of links that the box holds: those that move.
    """

    def __init__(self, robot: RobotModel, limits: Limits, torque: Torque) -> None:
        self.robot, self.limits, self.torque = robot, limits, torque
        self._driven = limits.effort.isfinite().nonzero().flatten().tolist()
        faces = [(axis, end) for axis in range(3) for end in range(2) if bool(limits.box[axis, end].isfinite())]
        self.points = self._moving_points() if faces else ()
        self._faces = faces if self.points else []
        names = robot.joint_names
        self.labels = (
            *(f"the range of {names[j]}" for j in limits.moving),
            *(f"the speed of {names[j]}" for j in limits.moving),
            *(f"the torque of {names[j]}" for j in self._driven),
            *(f"the box at {AXES[axis]} = {float(limits.box[axis, end]):g} m" for axis, end in self._faces),
        )

    def uses(self, t: Tensor, q: Tensor, qd: Tensor, qdd: Tensor) -> list[Tensor]:
        """Return how much of its limits each sample uses: blocks (*batch, M, limits) in the order of ``labels``.

        Args:
            t: (N,) times.
            q, qd, qdd: (*batch, N, n) states.
        """
        limits, moving = self.limits, self.limits.moving
        blocks = [(q - limits.middle)[..., moving] / limits.half[moving], qd[..., moving] / limits.fastest[moving]]
        if self._driven:
            blocks.append(self.torque(t, q, qd, qdd)[..., self._driven] / limits.strongest[self._driven])
        used = [torch.cat((block, -block), -2) for block in blocks]
        if self._faces:
            p = self.positions(q).flatten(-3, -2)
            out = [(p[..., axis] - limits.box[axis, end]) * (1.0 if end else -1.0) for axis, end in self._faces]
            used.append(1.0 + (torch.stack(out, -1) + _ROOM) / _LENGTH)
        return used

    def smooth(self, t: Tensor, q: Tensor, qd: Tensor, qdd: Tensor) -> Tensor:
        """Return a smooth upper bound of what is used of each limit, (*batch, limits)."""
        return torch.cat([torch.logsumexp(_RHO * u, -2) / _RHO for u in self.uses(t, q, qd, qdd)], -1)

    def greatest(self, t: Tensor, q: Tensor, qd: Tensor, qdd: Tensor) -> Tensor:
        """Return what is used of each limit, (*batch, limits)."""
        return torch.cat([u.amax(-2) for u in self.uses(t, q, qd, qdd)], -1)

    def positions(self, q: Tensor) -> Tensor:
        """Return where the points are, (*batch, points, 3) in the base's axes [m]."""
        R, p = self.robot.body_poses(q)
        at = [point.body for point in self.points]
        places = torch.stack([point.place for point in self.points])
        return p[..., at, :] + (R[..., at, :, :] @ places.unsqueeze(-1)).squeeze(-1)

    def _moving_points(self) -> tuple[Point, ...]:
        """Return the origins of links that the joints move."""
        robot = self.robot
        every = tuple(
            Point(link.name, k, link.pose[:3, 3])
            for k, body in enumerate(robot.body_names)
            for link in robot.folded[body]
        )
        self.points = every
        generator = torch.Generator().manual_seed(0)
        u = 2.0 * torch.rand(_POSTURES, robot.n_dof, generator=generator, dtype=torch.float64) - 1.0
        seen = self.positions(self.limits.middle + self.limits.half * u)
        moved = (seen.amax(0) - seen.amin(0)).amax(1) > _STILL
        return tuple(point for point, own in zip(every, moved.tolist(), strict=True) if own)
