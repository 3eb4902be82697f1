"""Match a robot's signals with the columns of a table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import compress
from pathlib import Path

import numpy as np

from torchrbd.display import Remark
from torchrbd.errors import RecordingError
from torchrbd.recordings.drives import Drive
from torchrbd.recordings.guessing import torque_like
from torchrbd.recordings.mapping import Mapping, Source, meant

PARTIAL_SIGNALS = ("tau", "qd", "qdd", "q_ref", "q_link", "temperature")
"""Signals that some joints may have and others not."""
# Those that are used only if all joints have them, and of these, those that drives use joint by joint.
_OF_ALL_JOINTS, _OF_DRIVES = ("qd", "qdd", "q_ref"), ("qd", "q_ref")
# Prefixes of columns that get no note if they are not used.
_OPTIONAL_CHANNELS = ("q_link_", "temperature_", "current_", "wrench_")


@dataclass(frozen=True)
class Match:
    """The columns of a robot's signals.

    Attributes:
        sources: by signal, "t" and those that exist, one for each joint that has it.
        there: by signal that some joints may lack, (n,) bool.
        drives: by joint, whose torque is computed from its set-point.
        notes: what is not used.
    """

    sources: dict[str, tuple[Source, ...]]
    there: dict[str, np.ndarray]
    drives: dict[str, Drive]
    notes: tuple[Remark, ...]


def match(columns: Sequence[str], joints: Sequence[str], mapping: Mapping, place: str, torque: bool = True) -> Match:
    """Match columns with joints.

    Args:
        columns: of the table.
        joints: the robot's joints, in its order.
        mapping: names of the columns.
        place: file or name, for messages.
        torque: whether at least one joint must have a torque.

    Raises:
        RecordingError: columns are missing; names those present, and the closest matches.
    """
    keys = ("q", *PARTIAL_SIGNALS)
    wanted = {key: [mapping.source(joint, index, key) for index, joint in enumerate(joints)] for key in keys}
    present = set(columns)
    drives = {joint: drive for joint in joints if (drive := mapping.drive(joint)) is not None}
    driven = np.array([joint in drives for joint in joints])
    required = [mapping.time, *wanted["q"], *mapping.named(joints), *compress(wanted["q_ref"], driven)]
    missing = list(dict.fromkeys(source.column for source in required if source.column not in present))
    if missing:
        known = {source.column for sources in wanted.values() for source in sources}
        others = [column for column in columns if column not in known]
        raise RecordingError(
            f"{place}: missing columns: {', '.join(missing)}{_of_drives(missing, wanted['q_ref'], drives)}"
            f"{meant(missing[0], others)}; "
            f"present: {', '.join(columns)}; if they have other names, give a mapping: "
            f"'torchrbd inspect RECORDING ROBOT -o mapping.yaml' writes one to edit"
            f"{no_torque(columns) if torque and not drives else ''}"
        )
    there = {key: np.array([s.column in present for s in wanted[key]]) for key in PARTIAL_SIGNALS}
    there["tau"] &= ~driven
    if torque and not (there["tau"] | driven).any():
        raise torqueless(place, columns, [source.column for source in wanted["tau"]])
    notes = _unit_currents(joints, wanted["tau"], there["tau"])
    without = list(compress(joints, ~there["tau"] & ~driven))
    notes += [Remark("no torque", {"joints": without})] if without else []
    for key in _OF_ALL_JOINTS:
        if there[key].all():
            continue
        used = there[key] & driven & (key in _OF_DRIVES)
        notes += [Remark("signal of some joints", {"signal": key})] if there[key].any() and not used.any() else []
        there[key] = used
    sources = {"t": (mapping.time,), "q": tuple(wanted["q"])}
    sources |= {key: tuple(compress(wanted[key], some)) for key, some in there.items() if some.any()}
    known = {source.column for group in wanted.values() for source in group} | {mapping.time.column}
    known -= {source.column for source in compress(wanted["tau"], driven)}
    ignored = [c for c in columns if c not in known and not c.startswith(_OPTIONAL_CHANNELS)]
    if ignored:
        notes.append(Remark("unused columns", {"columns": ignored}))
    return Match(sources, there, drives, tuple(notes))


def _of_drives(missing: Sequence[str], set_points: Sequence[Source], drives: dict[str, Drive]) -> str:
    """Say that a missing column is the set-point of a drive; nothing otherwise."""
    lacking = any(source.column in missing for source in set_points)
    return ", the set-points that drives follow" if drives and lacking else ""


def torqueless(place: str | Path, columns: Sequence[str], expected: Sequence[str] = ()) -> RecordingError:
    """Return the error of a table without a torque.

    Args:
        place: file or name.
        columns: of the table.
        expected: those that would be torques, if these are known.
    """
    wanted = f"; expected at least one of {', '.join(expected)}; present: {', '.join(columns)}" if expected else ""
    return RecordingError(f"{place}: no joint has a torque{wanted}{no_torque(columns) or unnamed_torque(columns)}")


def no_torque(columns: Sequence[str]) -> str:
    """Say that a table has no torque, and what to do, to go behind a message; nothing if a column may be one."""
    if torque_like(columns):
        return ""
    return (
        "; no column looks like a torque or a motor current. Record one with the positions, or, if position drives "
        "follow recorded set-points, give their gains in a mapping: joints: {'*': {drive: {kp: 20, kd: 0.5}}}"
    )


def unnamed_torque(columns: Sequence[str]) -> str:
    """Say which columns may be torques or currents, and what to do, to go behind a message."""
    return f"; if {', '.join(torque_like(columns))} hold torques or motor currents, name them in a mapping"


def _unit_currents(joints: Sequence[str], sources: Sequence[Source], there: np.ndarray) -> list[Remark]:
    """Remark on joints whose current is read with a constant of one, as a mapping has it before it is edited."""
    plain = [
        joint
        for joint, one, has in zip(joints, sources, there, strict=True)
        if has and one.is_current and abs(one.scale) == 1.0
    ]
    return [Remark("current as torque", {"joints": plain})] if plain else []
