"""Second moments of recordings with all that they depend on; those that were made alike add."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields, replace
from functools import reduce
from itertools import zip_longest

import torch
from torch import Tensor

from torchrbd.dataset.block_statistics import Block, BlockStatistics, halved
from torchrbd.dataset.columns import Columns
from torchrbd.display import Remark
from torchrbd.effects import JointScale
from torchrbd.errors import InputError

MOST_BLOCKS = 256
"""That a fit looks at, or one a recording."""

_REMEDIES = {
    "robot": "they are of different robots",
    "kinematics_sha256": "their URDFs differ in joints, axes, placements, rotors or springs; make all with one URDF",
    "joints": "their URDFs differ in joints; make all with one URDF",
    "gravity": "make all with one --gravity",
    "cutoff_hz": "make all with one --cutoff",
    "effects": "make all with the same --effects and --exclude",
    "used": "make all with the same --joints",
    "time": "make all with the same --time",
    "mapping_sha256": "make all with one --mapping",
    "encoder_noise": "make all with the same --encoder-noise",
}


@dataclass(frozen=True)
class Conditions:
    """What moments depend on, besides the recording.

    The URDF's inertias and friction are not among it: they are the prior of a fit, and may be others for each.

    Attributes:
        robot: its name.
        kinematics_sha256: of joints, axes, placements and bodies, and of rotors and springs that are known.
        joints: (n_dof,) names.
        gravity: (3,) [m/s^2].
        cutoff_hz: of the filters.
        effects: ids of those that have columns.
        used: joints whose torque counts.
        time: (from, to) [s]; None for all.
        mapping_sha256: of the mapping's file; None without one.
        encoder_noise: (n_dof,) as stated [rad, m], None where estimated.
    """

    robot: str
    kinematics_sha256: str
    joints: tuple[str, ...]
    gravity: tuple[float, ...]
    cutoff_hz: float
    effects: tuple[str, ...]
    used: tuple[str, ...]
    time: tuple[float, float] | None
    mapping_sha256: str | None
    encoder_noise: tuple[float | None, ...]

    def check(self, other: Conditions, own: str, others: str) -> None:
        """Raise InputError for what differs, with both values and the remedy; ``own`` and ``others`` are named."""
        for field in fields(self):
            a, b = getattr(self, field.name), getattr(other, field.name)
            if a != b:
                raise InputError(
                    f"{own} and {others} cannot be used together: {field.name} {_short(a)} and {_short(b)}; "
                    f"{_REMEDIES[field.name]}"
                )


def _short(value: object) -> str:
    return str(value)[:60]


@dataclass(frozen=True)
class Origin:
    """The recording that moments come from.

    Attributes:
        name: as results call it.
        size: of its files [bytes]; None where its content was not asked for, as for data in memory.
        sha256: of their content; None likewise.
        rows: that were read.
        duration_s: of its uninterrupted pieces together.
        position_noise: (n_dof,) standard deviations [rad, m].
        payload: known loads that were taken off, in words.
        notes: what a user should know of it.
    """

    name: str
    size: int | None
    sha256: str | None
    rows: int
    duration_s: float
    position_noise: tuple[float, ...]
    payload: tuple[str, ...]
    notes: tuple[Remark, ...]


@dataclass(frozen=True)
class Statistics:
    """Second moments of one recording or of several: what ``identify`` reads with ``estimator="moments"``.

    Attributes:
        conditions: what all of them depend on.
        origins: the recordings, in the order of the blocks.
        scales: (n_dof,) what they cover.
        labels: per joint (k_j,), of the columns behind the inertial ones.
        blocks: (B,) where each block sits.
        moments: per joint (B, p_j + 1, p_j + 1), see ``BlockStatistics``.
        torque: (B, n_dof, 3), see there.
        place: what messages call them, their file.
    """

    conditions: Conditions
    origins: tuple[Origin, ...]
    scales: tuple[JointScale, ...]
    labels: tuple[tuple[str, ...], ...]
    blocks: tuple[Block, ...]
    moments: tuple[Tensor, ...]
    torque: Tensor
    place: str

    def halved(self, times: int) -> Statistics:
        """Return the same with neighbouring blocks of each recording merged two by two, so many times."""
        blocks, (*moments, torque) = halved(self.blocks, (*self.moments, self.torque), times)
        return replace(self, blocks=blocks, moments=tuple(moments), torque=torque)

    def of_columns(self, columns: Columns) -> BlockStatistics:
        """Return the moments for fits.

        Raises:
            InputError: they are of other columns.
        """
        own = [m.shape[-1] - 1 for m in self.moments]
        if self.labels != columns.labels_of_joint or own != [len(one) for one in columns.of_joint]:
            raise InputError(f"{self.place}: moments are not of this robot's columns; make them anew")
        return BlockStatistics(columns, self.blocks, self.moments, self.torque)


def added(parts: Sequence[Statistics]) -> Statistics:
    """Return all of them as one, their blocks one after the other.

    Raises:
        InputError: they were made under different conditions, or two hold one recording.
    """
    if not parts:
        raise InputError("no statistics to add; give at least one file")
    first, *others = parts
    for one in others:
        first.conditions.check(one.conditions, first.place, one.place)
        _check_labels(first, one)
        if [m.shape[1:] for m in one.moments] != [m.shape[1:] for m in first.moments]:
            raise InputError(f"{first.place} and {one.place} hold moments of other columns; make them anew")
    check_names([(origin.name, one.place) for one in parts for origin in one.origins])
    return Statistics(
        conditions=first.conditions,
        origins=tuple(origin for one in parts for origin in one.origins),
        scales=tuple(reduce(_wider, own) for own in zip(*(one.scales for one in parts), strict=True)),
        labels=first.labels,
        blocks=tuple(block for one in parts for block in one.blocks),
        moments=tuple(torch.cat(own) for own in zip(*(one.moments for one in parts), strict=True)),
        torque=torch.cat([one.torque for one in parts]),
        place=f"{first.place} and {len(others)} more" if others else first.place,
    )


def _check_labels(one: Statistics, other: Statistics) -> None:
    for joint, *labels in zip(one.conditions.joints, one.labels, other.labels, strict=True):
        for a, b in zip_longest(*labels, fillvalue="nothing"):
            if a != b:
                raise InputError(
                    f"{one.place} has '{a}' at {joint}, {other.place} has '{b}': moments of other columns do not add; "
                    "leave out the effect of which it is"
                )


def check_names(named: Iterable[tuple[str, str]]) -> None:
    """Raise InputError for two recordings (name, place) of one name."""
    seen: dict[str, str] = {}
    for name, place in named:
        if name in seen:
            raise InputError(f"'{name}' is in {seen[name]} and in {place}; give it once, or rename one recording")
        seen[name] = place


def _wider(one: JointScale, other: JointScale) -> JointScale:
    """Return what two recordings cover together, at the rest width of the noisier one."""
    warm = None
    if one.temperature and other.temperature:
        warm = (min(one.temperature[0], other.temperature[0]), max(one.temperature[1], other.temperature[1]))
    return replace(
        one,
        speed_max=max(one.speed_max, other.speed_max),
        rest_width=max(one.rest_width, other.rest_width),
        q_low=min(one.q_low, other.q_low),
        q_high=max(one.q_high, other.q_high),
        duration_s=max(one.duration_s, other.duration_s),
        temperature=warm,
    )


def known(values: Tensor) -> tuple[float | None, ...]:
    """Return numbers (n,), None for NaN, which equals nothing."""
    return tuple(None if math.isnan(x) else x for x in values.tolist())
