"""The hypotheses: ways in which a table is often written wrong, each with the correction that it asks for."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from statistics import median

import torch

from torchrbd.inference.suspicions.writing import Writing
from torchrbd.recordings.mapping import TIME_UNITS
from torchrbd.robot import RobotModel

_DEGREE = math.pi / 180.0
TESTED = (
    "degrees",
    "millimetres",
    "time unit",
    "sign",
    "swapped columns",
    "gravity",
    "torque gain",
    "clipped torque",
    "variant",
    "set-points",
)
"""Kinds of what is looked for."""


@dataclass(frozen=True)
class Hypothesis:
    """One way to have written a table.

    Attributes:
        kind: as of a ``Suspicion``.
        joints: (k,) joints whose columns it reads otherwise; none if it is about time or gravity.
        writing: what the columns mean then.
        unit: that is meant, where that is what is wrong.
    """

    kind: str
    joints: tuple[int, ...]
    writing: Writing
    unit: str = ""

    @property
    def is_swap(self) -> bool:
        """Say whether columns of two joints are exchanged."""
        return self.kind.startswith("swapped")


def hypotheses(
    robot: RobotModel, now: Writing, worst: Sequence[int], converted: Collection[str]
) -> Iterator[Hypothesis]:
    """Yield all ways to have written a table that are one step away.

    Args:
        robot: the robot.
        now: how the table is read now.
        worst: joints that are explained worst; what concerns single joints is looked for at these.
        converted: signals, "t" and "q", whose unit a mapping converts: without need, perhaps.
    """
    yield from _units(robot, now, worst, converted)
    yield from _signs(robot, now, worst)
    yield from _exchanged(now, worst)
    yield from _gravities(robot, now)


def _units(robot: RobotModel, now: Writing, worst: Sequence[int], converted: Collection[str]) -> Iterator[Hypothesis]:
    turning = tuple(torch.nonzero(~robot.prismatic).flatten().tolist())
    sliding = tuple(torch.nonzero(robot.prismatic).flatten().tolist())
    for joints in dict.fromkeys((turning, *((j,) for j in worst if j in turning))):
        if joints:
            yield Hypothesis("degrees", joints, now.scaled_q(joints, _DEGREE), "deg")
    if turning and "q" in converted:
        yield Hypothesis("radians", turning, now.scaled_q(turning, 1.0 / _DEGREE), "rad")
    if sliding:
        yield Hypothesis("millimetres", sliding, now.scaled_q(sliding, 1e-3), "mm")
    if now.time == 1.0:
        for unit, factor in TIME_UNITS.items():
            if unit != "s":
                yield Hypothesis("time unit", (), replace(now, time=factor), unit)
        if "t" in converted:
            yield Hypothesis("time unit", (), replace(now, time=1e3), "s")


def _signs(robot: RobotModel, now: Writing, worst: Sequence[int]) -> Iterator[Hypothesis]:
    every = tuple(range(robot.n_dof))
    for joints in dict.fromkeys((every, *((j,) for j in worst))):
        yield Hypothesis("torque sign", joints, now.scaled_tau(joints, -1.0))
        yield Hypothesis("position sign", joints, now.scaled_q(joints, -1.0))
        yield Hypothesis("direction", joints, now.scaled_tau(joints, -1.0).scaled_q(joints, -1.0))


def _exchanged(now: Writing, worst: Sequence[int]) -> Iterator[Hypothesis]:
    ways = {"swapped torques": (False, True), "swapped positions": (True, False), "swapped joints": (True, True)}
    for k, one in enumerate(worst):
        for other in worst[:k]:
            for kind, (q, tau) in ways.items():
                yield Hypothesis(kind, tuple(sorted((one, other))), now.swapped(one, other, q=q, tau=tau))


def _gravities(robot: RobotModel, now: Writing) -> Iterator[Hypothesis]:
    size = math.hypot(*now.gravity)
    if not size:
        return
    own = torch.tensor(now.gravity, dtype=torch.float64) / size
    axes = torch.cat((torch.eye(3, dtype=torch.float64), -torch.eye(3, dtype=torch.float64)))
    # The writing nearest to the given one is the given one.
    for axis in sorted(axes.tolist(), key=lambda axis: float(own @ own.new_tensor(axis))):
        if float(own @ own.new_tensor(axis)) < 0.5:
            yield Hypothesis("gravity", (), replace(now, gravity=tuple(size * x + 0.0 for x in axis)))


def gains(now: Writing, gain: Sequence[float]) -> Iterator[Hypothesis]:
    """Yield torques in another unit, the same for all or each joint's own.

    Args:
        now: how the table is read now.
        gain: (n_dof,) by which its torques exceed the URDF's; not above zero where unknown.
    """
    driven = [j for j, g in enumerate(gain) if g > 0]
    if not driven:
        return
    logs = [math.log(gain[j]) for j in driven]
    yield Hypothesis("torque gain", tuple(driven), now.scaled_tau(range(len(gain)), math.exp(-median(logs))), "all")
    if len(driven) > 1:
        own = now
        for j in driven:
            own = own.scaled_tau([j], 1.0 / gain[j])
        yield Hypothesis("torque gain", tuple(driven), own, "each")
