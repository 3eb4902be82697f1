"""Write a mapping to edit: the columns of a file, with guesses from their names."""

from __future__ import annotations

import json
import math

from torchrbd.recordings.drives import Drive
from torchrbd.recordings.guessing import guess, unit_in_name
from torchrbd.recordings.inspection import Inspection
from torchrbd.recordings.mapping import CURRENT_UNITS, ESTIMATE, SIGNALS, TIME_UNITS, UNITS, Mapping, Source

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
_KEYS = f"""\
# Every key: "Recordings and mappings" in the documentation, docs/guide/recordings.md.
# Top level
#   time          column; unit: {", ".join(TIME_UNITS)}
#   joints        an entry for each joint of the URDF; "*" is every joint that has none of its own
#   topic         of a ROS bag or a PlotJuggler export with several
#   episodes      of a LeRobot data set, e.g. [0, 3]
#   torque_delay  seconds by which torques are written later than positions
#   set_point_delay  seconds after which drives follow a recorded set-point
# Signals of a joint, each NAME or {{column: NAME, ...}}; {{joint}} and {{index}} (from 0) in a name are filled in
#   q             position: {", ".join(UNITS["q"])}
#   qd            velocity, optional: {", ".join(UNITS["qd"])}
#   qdd           acceleration, optional: {", ".join(UNITS["qdd"])}
#   tau           torque: {", ".join(UNITS["tau"])}
#   q_ref         set-point, optional; units of q
#   q_link        encoder behind the gear, optional; units of q
#   temperature   optional: {", ".join(UNITS["temperature"])}
#   drive         in place of tau: a position drive that follows q_ref; its torque is kp (q_ref - q) - kd qd
# Keys of a drive, such as {{kp: 20, kd: 0.5, limit: 23}}
#   kp            stiffness [N m/rad, N/m]
#   kd            damping [N m s/rad, N s/m]; 0 by default
#   limit         greatest torque of either sign [N m, N]; none by default
# Keys of a signal
#   column        name of the column
#   unit          one of those above; the first is the default
#   sign          1 or -1, where the column counts the other way than the URDF
#   scale         any other factor
#   gear_ratio    N, where the column is of the motor: q = column / N, tau = column * N
#   offset        added last [rad, m, N m, N]
# A torque from a motor current: tau = torque_constant * gear_ratio * current
#   current       name of the column, in place of 'column'; unit: {", ".join(CURRENT_UNITS)}
#   torque_constant  of the motor [N m/A], or [N/A] of a linear motor
"""
_CURRENT = (
    "{{current: {column}, unit: {unit}, torque_constant: 1.0, gear_ratio: 1.0}}"
    "  # guessed. Replace both 1.0: see the motor's data sheet"
)


def mapping_text(found: Inspection, mapping: Mapping, sliding: tuple[str, ...] = ()) -> str:
    """Return the mapping in use as YAML, with suspected errors as comments.

    Args:
        found: the inspection of the file.
        mapping: used to read it.
        sliding: the robot's prismatic joints.
    """
    lines = [
        f"# Mapping for {json.dumps(found.name)}. Check each line, then give this file to --mapping.",
        *_KEYS.splitlines(),
    ]
    if mapping.topic is not None:
        lines.append(f"topic: {json.dumps(mapping.topic)}")
    if mapping.episodes is not None:
        lines.append(f"episodes: {list(mapping.episodes)}")
    if mapping.torque_delay_s:
        lines.append(f"torque_delay: {mapping.torque_delay_s!r}")
    if mapping.set_point_delay_s:
        lines.append(f"set_point_delay: {mapping.set_point_delay_s!r}")
    lines += _found(found, sliding) if found.recording is not None else _guessed(found)
    return "\n".join(lines) + "\n"


def _found(found: Inspection, sliding: tuple[str, ...]) -> list[str]:
    recording = found.recording
    assert recording is not None
    time = recording.source("t", "") or Source("t")
    now = next(name for name, seconds in TIME_UNITS.items() if seconds == time.scale)
    # The suspected unit refers to the time as it is read now.
    meant = time.scale * TIME_UNITS[found.units.get(time.column, "s")]
    unit = next((name for name, seconds in TIME_UNITS.items() if math.isclose(seconds, meant)), now)
    guess_words = _suspected(unit, now) if unit != now else ""
    lines = [f"time: {{column: {json.dumps(time.column)}, unit: {unit}}}{guess_words}", "joints:"]
    _, guesses = guess(found.columns, found.joints)
    for joint in recording.joints:
        lines.append(f"  {json.dumps(joint)}:")
        if joint in recording.drives.of:
            lines.append(f"    drive: {_drive(recording.drives.of[joint])}")
        for signal in SIGNALS:
            source = recording.source(signal, joint)
            if source is not None:
                symbol = _SLIDING.get(_UNITS[signal], _UNITS[signal]) if joint in sliding else _UNITS[signal]
                unit = symbol if source.is_current else found.units.get(source.column, symbol)
                guess_words = _suspected(unit, symbol) if unit != symbol else ""
                lines.append(f"    {signal}: {_entry(source, unit)}{guess_words}")
            elif signal == "tau" and joint not in recording.drives.of:
                lines += _guessed_torque(guesses.get(joint, {}))
    return lines


def _guessed_torque(signals: dict[str, str]) -> list[str]:
    """Return the line of a guessed torque, or of a current instead; none if there is neither."""
    if "tau" in signals:
        return [f"    tau: {{column: {json.dumps(signals['tau'])}, unit: N m}}  # guessed"]
    if "current" not in signals:
        return []
    column = signals["current"]
    return [f"    tau: {_CURRENT.format(column=json.dumps(column), unit=unit_in_name(column, 'current') or 'A')}"]


def _entry(source: Source, unit: str) -> str:
    if source.is_current:
        constant = repr(abs(source.scale)) if source.is_known else ESTIMATE
        keys = [f"current: {json.dumps(source.column)}", "unit: A", f"torque_constant: {constant}"]
        keys += [f"gear_ratio: {abs(source.scale)!r}"] * (not source.is_known)
        keys += ["sign: -1"] * (source.scale < 0.0) + [f"offset: {source.offset!r}"] * (source.offset != 0.0)
        return f"{{{', '.join(keys)}}}  # torque_constant includes the gear ratio"
    keys = [f"column: {json.dumps(source.column)}", f"unit: {unit}"]
    keys += [f"scale: {source.scale!r}"] * (source.scale != 1.0) + [f"offset: {source.offset!r}"] * (
        source.offset != 0.0
    )
    return f"{{{', '.join(keys)}}}"


def _drive(drive: Drive) -> str:
    keys = [f"kp: {drive.kp!r}" if drive.is_known else f"kp: {ESTIMATE}", f"kd: {drive.kd!r}"]
    keys += [f"limit: {drive.limit!r}"] * math.isfinite(drive.limit)
    return f"{{{', '.join(keys)}}}"


def _suspected(unit: str, otherwise: str) -> str:
    return f"  # a guess, from the size of the values: if it is wrong, write {otherwise} in place of {unit}"


def _guessed(found: Inspection) -> list[str]:
    """Return guesses from the names of the columns, and the columns without a guess."""
    numbers = [name for name in found.columns if found.ranges[name][0] <= found.ranges[name][1]]
    time, joints = guess(numbers, found.joints)
    unit = unit_in_name(time or "", "time") or "s"
    lines = [f"time: {{column: {json.dumps(time or 't')}, unit: {unit}}}  # {'guessed' if time else 'name the column'}"]
    lines.append("joints:" if joints else "joints: {}  # no column names show a joint and a signal")
    used = {time}
    for joint, signals in joints.items():
        lines.append(f"  {json.dumps(joint)}:")
        for signal, column in signals.items():
            used.add(column)
            if signal in ("q", "qd"):
                unit = unit_in_name(column, signal, joint) or _UNITS[signal]
                lines.append(f"    {signal}: {{column: {json.dumps(column)}, unit: {unit}}}  # guessed")
        lines += _guessed_torque(signals)
    left = [name for name in found.columns if name not in used]
    return [*lines, *([f"# other columns: {', '.join(map(json.dumps, left))}"] if left else [])]
