"""Match a robot's signals with the columns of a table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import compress

import numpy as np

from torchrbd.errors import RecordingError
from torchrbd.recordings.guessing import torque_like
from torchrbd.recordings.mapping import Mapping, Source, meant

OPTIONAL_SIGNALS = ("qd", "qdd", "q_ref")
"""Signals that all joints have, or none."""
PARTIAL_SIGNALS = ("q_link", "temperature")
"""Signals that some joints may have and others not."""
# Prefixes of columns that get no note if they are not used.
_OPTIONAL_CHANNELS = ("q_link_", "temperature_", "current_", "wrench_")


@dataclass(frozen=True)
class Match:
    """The columns of a robot's signals.

    Attributes:
        sources: by signal, "t" and those that exist, one for each joint that has it.
        there: by signal that some joints may lack, (n,) bool.
        notes: what is not used.
    """

    sources: dict[str, tuple[Source, ...]]
    there: dict[str, np.ndarray]
    notes: tuple[str, ...]


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
    wanted = {
        key: [mapping.source(joint, index, key) for index, joint in enumerate(joints)]
        for key in ("q", "tau", *OPTIONAL_SIGNALS, *PARTIAL_SIGNALS)
    }
    present = set(columns)
    required = [mapping.time, *wanted["q"], *mapping.named(joints)]
    missing = list(dict.fromkeys(source.column for source in required if source.column not in present))
    if missing:
        known = {source.column for sources in wanted.values() for source in sources}
        others = [column for column in columns if column not in known]
        raise RecordingError(
            f"{place}: missing columns: {', '.join(missing)}{meant(missing[0], others)}; "
            f"present: {', '.join(columns)}; if they have other names, give a mapping: "
            f"'torchrbd inspect RECORDING ROBOT -o mapping.yaml' writes one to edit"
            f"{no_torque(columns) if torque else ''}"
        )
    there = {key: np.array([s.column in present for s in wanted[key]]) for key in ("tau", *PARTIAL_SIGNALS)}
    if torque and not there["tau"].any():
        expected = ", ".join(source.column for source in wanted["tau"])
        raise RecordingError(
            f"{place}: no joint has a torque; expected at least one of {expected}; present: {', '.join(columns)}"
            f"{no_torque(columns) or unnamed_torque(columns)}"
        )
    notes = _unit_currents(joints, wanted["tau"], there["tau"])
    sources = {"t": (mapping.time,), "q": tuple(wanted["q"])}
    for key, some in there.items():
        if some.any():
            sources[key] = tuple(compress(wanted[key], some))
    if not there["tau"].all():
        notes.append("no torque for " + ", ".join(compress(joints, ~there["tau"])))
    for key in OPTIONAL_SIGNALS:
        found = [source.column in present for source in wanted[key]]
        if all(found):
            sources[key] = tuple(wanted[key])
        elif any(found):
            notes.append(f"{key} is not used: it is there for some joints only")
    known = {source.column for group in wanted.values() for source in group} | {mapping.time.column}
    ignored = [c for c in columns if c not in known and not c.startswith(_OPTIONAL_CHANNELS)]
    if ignored:
        notes.append("columns not used: " + ", ".join(ignored))
    return Match(sources, there, tuple(notes))


def no_torque(columns: Sequence[str]) -> str:
    """Say that a table has no torque, and what to do, to go behind a message; nothing if a column may be one."""
    if torque_like(columns):
        return ""
    return (
        "; no column looks like a torque or a motor current, and torchrbd needs one: record it with the positions. "
        "Positions and set-points without torque are not supported yet"
    )


def unnamed_torque(columns: Sequence[str]) -> str:
    """Say which columns may be torques or currents, and what to do, to go behind a message."""
    return f"; if {', '.join(torque_like(columns))} hold torques or motor currents, name them in a mapping"


def _unit_currents(joints: Sequence[str], sources: Sequence[Source], there: np.ndarray) -> list[str]:
    """Say for which joints a current is read with a constant of one, as a mapping has it before it is edited."""
    plain = [
        joint
        for joint, one, has in zip(joints, sources, there, strict=True)
        if has and one.is_current and abs(one.scale) == 1.0
    ]
    if not plain:
        return []
    return [
        f"torque_constant times gear_ratio is 1 for {', '.join(plain)}: the torque is then the current in ampere, and "
        "masses and friction have a wrong scale. Put the values of the motor and its gear into the mapping"
    ]
