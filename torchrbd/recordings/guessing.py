"""Guess the columns of an unknown table from their names."""

from __future__ import annotations

import re
from collections.abc import Sequence

_WORDS = {
    "time": r"time|timestamp|stamp|t|sec|secs|seconds|clock|zeit",
    "qd": r"qd|dq|qdot|velocity|velocities|vel|speed|omega|qp|geschwindigkeit|drehzahl",
    "tau": r"tau|effort|efforts|torque|torques|trq|force|moment|drehmoment",
    "current": r"current|currents|curr|amps|i|strom",
    "q": r"q|pos|position|positions|angle|angles|theta|state|winkel",
}
_OTHERS = re.compile(r"ref|cmd|command|commanded|desired|des|target|goal|setpoint|sp|error|err|action|acc|ddq|qdd")
_UNITS = {
    "time": {"ms": r"ms|msec|millis|milliseconds", "us": r"us|usec|micros|microseconds", "ns": r"ns|nsec|nanoseconds"},
    "q": {"deg": r"deg|degs|degree|degrees|grad", "mrad": r"mrad", "mm": r"mm"},
    "qd": {"deg/s": r"deg|degs|degree|degrees|grad", "rpm": r"rpm", "mm/s": r"mm|mmps"},
    "current": {"mA": r"ma"},
}
_LETTERS = re.compile(r"[A-Za-z]+")
_PART = re.compile(r"[A-Z]?[a-z]+|[A-Z]+|\d+")


def guess(columns: Sequence[str], joints: Sequence[str] = ()) -> tuple[str | None, dict[str, dict[str, str]]]:
    """Guess the columns of time and of the joints.

    Args:
        columns: the table's.
        joints: the robot's, if known; otherwise they are named joint1, joint2, and so on.

    Returns: the column of time, None if there is none; by joint, column by signal: q, qd, tau or current.
    """
    time, groups = None, dict[str, dict[str, str]]()
    for column in columns:
        signal, key = _guess(column, joints)
        if signal == "time" and time is None:
            time = column
        elif signal not in (None, "time") and key:
            groups.setdefault(key, {}).setdefault(str(signal), column)
    named = {joint: groups[joint] for joint in joints if joint in groups}
    if named:
        return time, named
    numbered = [groups[key] for key in sorted((k for k in groups if k.isdigit()), key=int) if "q" in groups[key]]
    if joints and len(numbered) != len(joints):
        return time, _in_order(columns, joints)
    names = joints or tuple(f"joint{k}" for k in range(1, len(numbered) + 1))
    return time, dict(zip(names, numbered, strict=False))


def torque_like(columns: Sequence[str]) -> list[str]:
    """Return the columns whose names suggest a torque or a motor current."""
    return [column for column in columns if _guess(column, ())[0] in ("tau", "current")]


def unit_in_name(column: str, signal: str, joint: str = "") -> str:
    """Return the unit that a column's name ends with or holds, such as deg in ``J1_pos_deg``; empty if there is none.

    Args:
        column: the name.
        signal: time, q, qd or current; other signals have no known endings.
        joint: the joint that the name holds, whose letters say nothing about the unit.
    """
    text = column.replace(joint, " ") if joint else column
    parts = {part.lower() for part in (*_LETTERS.findall(text), *_PART.findall(text))}
    units = _UNITS.get(signal, {})
    return next((unit for unit, words in units.items() if any(re.fullmatch(words, part) for part in parts)), "")


def _in_order(columns: Sequence[str], joints: Sequence[str]) -> dict[str, dict[str, str]]:
    """Return the signals of columns with neither a joint's name nor a number, where there is one for each joint."""
    found: dict[str, list[str]] = {}
    for column in columns:
        signal, key = _guess(column, joints)
        if signal not in (None, "time") and key is None:
            found.setdefault(str(signal), []).append(column)
    fitting = {signal: names for signal, names in found.items() if len(names) == len(joints)}
    if "q" not in fitting:
        return {}
    return {joint: {signal: names[k] for signal, names in fitting.items()} for k, joint in enumerate(joints)}


def _guess(column: str, joints: Sequence[str]) -> tuple[str | None, str | None]:
    """Return the signal and the joint, or the joint's number, in a column's name."""
    key = max((joint for joint in joints if joint in column), key=len, default=None)
    parts = [part.lower() for part in _PART.findall(column.replace(key, " ") if key else column)]
    if any(_OTHERS.fullmatch(part) for part in parts):
        return None, None
    signal = next((one for one, words in _WORDS.items() if any(re.fullmatch(words, part) for part in parts)), None)
    numbers = [part for part in parts if part.isdigit()]
    return signal, key or (numbers[-1] if numbers else None)
