"""Match a robot's signals with the columns of a table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import compress
from pathlib import Path

import numpy as np

from torchrbd.display import Remark
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
        raise torqueless(place, columns, [source.column for source in wanted["tau"]])
    notes = _unit_currents(joints, wanted["tau"], there["tau"])
    sources = {"t": (mapping.time,), "q": tuple(wanted["q"])}
    for key, some in there.items():
        if some.any():
            sources[key] = tuple(compress(wanted[key], some))
    if not there["tau"].all():
        notes.append(Remark("no torque", {"joints": list(compress(joints, ~there["tau"]))}))
    for key in OPTIONAL_SIGNALS:
        found = [source.column in present for source in wanted[key]]
        if all(found):
            sources[key] = tuple(wanted[key])
        elif any(found):
            notes.append(Remark("signal of some joints", {"signal": key}))
    known = {source.column for group in wanted.values() for source in group} | {mapping.time.column}
    ignored = [c for c in columns if c not in known and not c.startswith(_OPTIONAL_CHANNELS)]
    if ignored:
        notes.append(Remark("unused columns", {"columns": ignored}))
    return Match(sources, there, tuple(notes))


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
        "; no column looks like a torque or a motor current, and torchrbd needs one: record it with the positions. "
        "Positions and set-points without torque are not supported yet"
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
