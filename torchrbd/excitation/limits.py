"""What a motion must keep: ranges, speeds, torques, and a box for the links."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from torchrbd.errors import OptionError, closest
from torchrbd.robot import RobotModel
from torchrbd.robot.tree import build_tree

Range = tuple[float, float]
AXES = ("x", "y", "z")
# Less and more than any robot has, in SI units.
_LEAST, _LARGEST = 1e-9, 1e9


@dataclass(frozen=True)
class Limits:
    """The limits of a motion; all of it stays inside them by a margin.

    Attributes:
        lower, upper: (n,) ends of the ranges [rad or m].
        velocity: (n,) greatest speeds, at the share that was asked for [rad/s or m/s].
        effort: (n,) greatest torques [N m or N], infinite at a joint that stands still and has none.
        moves: (n,) bool; the others stand still at ``rest``.
        rest: (n,) where a joint stands still [rad or m].
        box: (3, 2) where the origins of links may be, in the base's axes [m]; infinite where open.
        margin: part of every range, speed and torque that is left free.
    """

    lower: Tensor
    upper: Tensor
    velocity: Tensor
    effort: Tensor
    moves: Tensor
    rest: Tensor
    box: Tensor
    margin: float

    @property
    def middle(self) -> Tensor:
        """Middle of each range (n,); where the joint stands still, if it does."""
        return torch.where(self.moves, 0.5 * (self.lower + self.upper), self.rest)

    @property
    def half(self) -> Tensor:
        """Half of the range (n,) that a joint may use; zero where it stands still."""
        return torch.where(self.moves, 0.5 * (1.0 - self.margin) * (self.upper - self.lower), 0.0)

    @property
    def fastest(self) -> Tensor:
        """Speed (n,) that a joint may use."""
        return (1.0 - self.margin) * self.velocity

    @property
    def strongest(self) -> Tensor:
        """Torque (n,) that a joint may use."""
        return (1.0 - self.margin) * self.effort

    @property
    def moving(self) -> list[int]:
        """Indices of the joints that move."""
        return self.moves.nonzero().flatten().tolist()

    def held(self) -> dict[int, float]:
        """Return the positions of the joints that stand still, by index."""
        return {j: float(self.rest[j]) for j in (~self.moves).nonzero().flatten().tolist()}


def limits_of(
    robot: RobotModel,
    *,
    joints: Sequence[str] | None = None,
    ranges: Mapping[str, Range] | None = None,
    velocities: Mapping[str, float] | None = None,
    efforts: Mapping[str, float] | None = None,
    box: Mapping[str, Range] | None = None,
    margin: float = 0.1,
    speed: float = 1.0,
) -> Limits:
    """Take the limits of a robot, and those that were given instead.

    Args:
        robot: whose limits hold unless others are given.
        joints: those that move; all by default.
        ranges: ends of a joint's range [rad or m]; a joint whose ends are equal stands still there.
        velocities, efforts: by joint [rad/s or m/s], [N m or N].
        box: "x", "y" or "z" and between what the origins of links may be [m].
        margin: part of every limit that is left free.
        speed: share of the speeds to use.

    Raises:
        OptionError: a limit is missing, names what is not there, or cannot be kept.
    """
    ranges, velocities, efforts = dict(ranges or {}), dict(velocities or {}), dict(efforts or {})
    _check_share("margin", margin, margin < 1.0)
    _check_share("speed", speed, speed > 0.0)
    for what, given in (("ranges", ranges), ("velocities", velocities), ("efforts", efforts), ("joints", joints or ())):
        _check_names(robot, what, given)
    lower, upper, velocity = _with_followers(robot)
    effort = robot.effort.clone()
    for name, (low, high) in ranges.items():
        if not -_LARGEST <= low <= high <= _LARGEST:
            raise OptionError(
                f"range of '{name}' is {low:g} to {high:g}; expected two numbers, the lower one first, at most "
                f"{_LARGEST:g}"
            )
        lower[robot.joint_names.index(name)], upper[robot.joint_names.index(name)] = low, high
    for what, values, given in (("speed", velocity, velocities), ("torque", effort, efforts)):
        for name, value in given.items():
            if not _LEAST <= value <= _LARGEST:
                raise OptionError(
                    f"greatest {what} of '{name}' is {value:g}; expected a positive number, {_LEAST:g} to {_LARGEST:g}"
                )
            values[robot.joint_names.index(name)] = value
    asked = torch.tensor([joints is None or name in joints for name in robot.joint_names])
    limits = Limits(
        lower=lower,
        upper=upper,
        velocity=speed * velocity,
        effort=effort,
        moves=asked & (lower != upper),
        rest=torch.zeros_like(lower).clamp(lower, upper),
        box=_box(box or {}),
        margin=margin,
    )
    _check(robot, limits)
    return limits


def _with_followers(robot: RobotModel) -> tuple[Tensor, Tensor, Tensor]:
    """Return ends of ranges and greatest speeds (n,) of the URDF, with which joints that mimic others keep theirs too.

    A joint at `multiplier q + offset` is as fast as the multiplier's size times the one that it follows.
    """
    lower, upper, velocity = robot.lower.clone(), robot.upper.clone(), robot.velocity.clone()
    tree = build_tree(robot.description)
    for joint, j, factor, offset in zip(tree.moving, tree.drivers, tree.multipliers, tree.offsets, strict=True):
        if joint.mimic is None or not factor:
            continue
        if joint.lower < joint.upper:
            ends = sorted(((joint.lower - offset) / factor, (joint.upper - offset) / factor))
            lower[j], upper[j] = lower[j].clamp_min(ends[0]), upper[j].clamp_max(ends[1])
        if joint.velocity > 0:
            velocity[j] = velocity[j].clamp_max(joint.velocity / abs(factor))
    return lower, upper, velocity


def _check_share(name: str, value: float, inside: bool) -> None:
    if not (0.0 <= value <= 1.0 and inside):
        raise OptionError(f"{name} is {value:g}; expected a part between 0 and 1")


def _check_names(robot: RobotModel, what: str, given: Collection[str]) -> None:
    for name in given:
        if name not in robot.joint_names:
            hint = f"{closest(name, robot.joint_names)} ".lstrip()
            raise OptionError(
                f"{what}: robot '{robot.name}' has no joint '{name}'; {hint}its joints are "
                f"{', '.join(robot.joint_names)}"
            )


def _box(given: Mapping[str, Range]) -> Tensor:
    box = torch.tensor([[-math.inf, math.inf]] * 3, dtype=torch.float64)
    for axis, (low, high) in given.items():
        if axis not in AXES:
            raise OptionError(f"box: there is no axis '{axis}'; expected one of {', '.join(AXES)}")
        if not low < high:
            raise OptionError(f"box: {axis} from {low:g} to {high:g} m holds nothing; give the lower end first")
        box[AXES.index(axis)] = torch.tensor([low, high], dtype=torch.float64)
    return box


def _check(robot: RobotModel, limits: Limits) -> None:
    """See that every limit which the motion needs is there.

    Raises:
        OptionError: one is not; says at which joints, and what to do.
    """
    if not bool(limits.moves.any()):
        raise OptionError(f"no joint of '{robot.name}' moves; name some in joints, and give them ranges to move in")
    missing = list(_missing(robot, limits))
    if missing:
        raise OptionError(
            f"robot '{robot.name}': {'; '.join(missing)}. Complete <limit> in the URDF, give the limits here, or leave "
            "such joints out of those that move"
        )


def _missing(robot: RobotModel, limits: Limits) -> Iterator[str]:
    """Yield in words which limits are missing, and the option that gives them."""
    unit = {True: ("0:0.5", "0.3", "100"), False: ("-3.1:3.1", "2", "10")}
    own: tuple[tuple[str, Tensor, str, int], ...] = (
        ("no lower and upper limit", limits.moves & ~(limits.upper - limits.lower).isfinite(), "--range", 0),
        ("its lower limit above the upper one", limits.moves & (limits.lower > limits.upper), "--range", 0),
        ("no speed limit", limits.moves & ~(limits.velocity.isfinite() & (limits.velocity > 0)), "--velocity", 1),
        ("no torque limit", limits.moves & ~limits.effort.isfinite(), "--effort", 2),
        ("a torque limit of zero (no actuator, or not known)", limits.effort <= 0, "--effort", 2),
    )
    for words, where, option, k in own:
        for j in where.nonzero().flatten().tolist():
            name, example = robot.joint_names[j], unit[bool(robot.prismatic[j])][k]
            yield f"joint '{name}' has {words} ({option} {name}={example})"
