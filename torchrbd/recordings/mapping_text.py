"""Write a mapping to edit: what was found in a file, and what is guessed from the names of its columns."""

from __future__ import annotations

import json

from torchrbd.recordings.guessing import guess
from torchrbd.recordings.inspection import Inspection
from torchrbd.recordings.mapping import SIGNALS, TIME_UNITS, Mapping, Source

_UNITS = {
    "q": "rad",
    "qd": "rad/s",
    "qdd": "rad/s^2",
    "tau": "N m",
    "q_ref": "rad",
    "q_link": "rad",
    "temperature": "degC",
}
_SLIDING = {"rad": "m", "rad/s": "m/s", "rad/s^2": "m/s^2", "N m": "N"}
_CURRENT = "{{current: {column}, unit: A, torque_constant: 1.0, gear_ratio: 1.0}}  # guessed; put in the motor's"


def mapping_text(found: Inspection, mapping: Mapping, sliding: tuple[str, ...] = ()) -> str:
    """Return a mapping in YAML that says what is read now, with what is suspected in comments.

    Args:
        found: what a look at the file showed.
        mapping: that it was read with.
        sliding: the robot's prismatic joints.
    """
    lines = [f"# Of {json.dumps(found.name)}. Correct it and give it to --mapping; see the README for the keys."]
    if mapping.topic is not None:
        lines.append(f"topic: {json.dumps(mapping.topic)}")
    if mapping.episodes is not None:
        lines.append(f"episodes: {list(mapping.episodes)}")
    if mapping.torque_delay_s:
        lines.append(f"torque_delay: {mapping.torque_delay_s!r}")
    lines += _found(found, sliding) if found.recording is not None else _guessed(found)
    return "\n".join(lines) + "\n"


def _found(found: Inspection, sliding: tuple[str, ...]) -> list[str]:
    recording = found.recording
    assert recording is not None
    time = recording.source("t", "") or Source("t")
    unit = next(name for name, seconds in TIME_UNITS.items() if seconds == time.scale)
    lines = [f"time: {{column: {json.dumps(time.column)}, unit: {unit}}}{_suspected(found, time.column)}", "joints:"]
    _, guesses = guess(found.columns, found.joints)
    for joint in recording.joints:
        lines.append(f"  {json.dumps(joint)}:")
        for signal in SIGNALS:
            source = recording.source(signal, joint)
            if source is not None:
                symbol = _SLIDING.get(_UNITS[signal], _UNITS[signal]) if joint in sliding else _UNITS[signal]
                lines.append(f"    {signal}: {_entry(source, symbol)}{_suspected(found, source.column)}")
            elif signal == "tau":
                lines += _guessed_torque(guesses.get(joint, {}))
    return lines


def _guessed_torque(signals: dict[str, str]) -> list[str]:
    """Return the line of a torque that is guessed, or of a current in its place; none if there is none."""
    if "tau" in signals:
        return [f"    tau: {{column: {json.dumps(signals['tau'])}, unit: N m}}  # guessed"]
    return [f"    tau: {_CURRENT.format(column=json.dumps(signals['current']))}"] if "current" in signals else []


def _entry(source: Source, unit: str) -> str:
    keys = [f"column: {json.dumps(source.column)}", f"unit: {unit}"]
    keys += [f"scale: {source.scale!r}"] * (source.scale != 1.0) + [f"offset: {source.offset!r}"] * (
        source.offset != 0.0
    )
    return f"{{{', '.join(keys)}}}"


def _suspected(found: Inspection, column: str) -> str:
    return f"  # looks like {found.units[column]}" if column in found.units else ""


def _guessed(found: Inspection) -> list[str]:
    """Return what the names of the columns suggest, and the columns that they do not tell."""
    numbers = [name for name in found.columns if found.ranges[name][0] <= found.ranges[name][1]]
    time, joints = guess(numbers, found.joints)
    lines = [f"time: {{column: {json.dumps(time or 't')}, unit: s}}  # {'guessed' if time else 'name the column'}"]
    lines.append("joints:" if joints else "joints: {}  # no names of columns that tell a joint and a signal")
    used = {time}
    for joint, signals in joints.items():
        lines.append(f"  {json.dumps(joint)}:")
        for signal, column in signals.items():
            used.add(column)
            if signal in ("q", "qd"):
                lines.append(f"    {signal}: {{column: {json.dumps(column)}, unit: {_UNITS[signal]}}}  # guessed")
        lines += _guessed_torque(signals)
    left = [name for name in found.columns if name not in used]
    return [*lines, *([f"# other columns: {', '.join(map(json.dumps, left))}"] if left else [])]
