"""Guess the columns of an unknown table from their names."""

from __future__ import annotations

import re
from collections.abc import Sequence

_WORDS = {
    "time": r"time|timestamp|stamp|t|sec|secs|seconds|clock",
    "qd": r"qd|dq|qdot|velocity|velocities|vel|speed|omega|qp",
    "tau": r"tau|effort|efforts|torque|torques|trq|force|moment",
    "current": r"current|currents|curr|amps|i",
    "q": r"q|pos|position|positions|angle|angles|theta|state",
}
_OTHERS = re.compile(r"ref|cmd|command|commanded|desired|des|target|goal|setpoint|sp|error|err|action|acc|ddq|qdd")
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
        return time, {}
    names = joints or tuple(f"joint{k}" for k in range(1, len(numbered) + 1))
    return time, dict(zip(names, numbered, strict=False))


def _guess(column: str, joints: Sequence[str]) -> tuple[str | None, str | None]:
    """Return the signal and the joint, or the joint's number, in a column's name."""
    key = max((joint for joint in joints if joint in column), key=len, default=None)
    parts = [part.lower() for part in _PART.findall(column.replace(key, " ") if key else column)]
    if any(_OTHERS.fullmatch(part) for part in parts):
        return None, None
    signal = next((one for one, words in _WORDS.items() if any(re.fullmatch(words, part) for part in parts)), None)
    numbers = [part for part in parts if part.isdigit()]
    return signal, key or (numbers[-1] if numbers else None)
