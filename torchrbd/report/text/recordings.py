"""What a user should know of a recording: what is not used, what was dropped, what looks wrong."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from torchrbd.recordings import Survey
from torchrbd.recordings.motions import Motion
from torchrbd.report.text.numbers import as_many_as_fit

_WORDS = 14
_LACKS = {
    "any motion": "it never moves",
    "range": "little range",
    "speed": "slow",
    "reversals": "hardly turns back",
    "any reversal": "never turns back",
}


def survey_words(seen: Survey, joints: int) -> str:
    """Say what a recording of so many joints holds."""
    pieces = "no gaps" if len(seen.segments) == 1 else f"{len(seen.segments)} pieces with gaps between them"
    lost = seen.duplicates + seen.incomplete
    rows = f"{seen.rows} rows" + (f", {lost} of them not usable" if lost else "")
    number = "one joint" if joints == 1 else f"{joints} joints"
    return (
        f"{number}, {rows}, {seen.rate_hz:.4g} Hz, {seen.duration_s:.4g} s, {pieces}; motion up to "
        f"{seen.cutoff_hz:.2g} Hz"
    )


def lacks_words(motion: Motion) -> str:
    """Say what the motion of a joint has too little of; "yes" if it is rich enough."""
    return ", ".join(_LACKS[one] for one in motion.lacks) or "yes"


def unmatched_words(columns: int) -> str:
    """Say what a file holds that is no recording yet."""
    return f"{columns} columns, not matched with joints"


def _current_as_torque(joints: Sequence[str]) -> str:
    return (
        f"torque_constant times gear_ratio is 1 for {_list(joints)}. The torque is then the current in ampere, "
        "and masses and friction have a wrong scale. Put the values of the motor and its gear into the mapping"
    )


def _jumps(joint: str, speed: float, ratio: float) -> str:
    return f"q_{joint} jumps: {speed:.3g} per second is {ratio:.0f} times its RMS speed; look for bad samples"


def _peaks(joint: str, torque: float, ratio: float) -> str:
    return f"tau_{joint} peaks at {torque:.3g}, {ratio:.0f} times its RMS; look for bad samples"


def _velocity_differs(joint: str, ratio: float) -> str:
    return f"qd_{joint} is {ratio:.3g} times dq/dt and not used; check its unit and sign, and those of q and t"


def _link_differs(joint: str, ratio: float) -> str:
    return f"q_link_{joint} moves {ratio:.3g} times as far as q_{joint} and is not used; check its unit, sign and gear"


def _torque_constant(joint: str, torque: float, begin_s: float, end_s: float) -> str:
    return (
        f"tau_{joint} is exactly {torque:.3g} from {begin_s:.2f} to {end_s:.2f} s while {joint} moves: its drive is "
        "off then, or its torque was not recorded. Leave that time out if it was not recorded"
    )


def _repeated_times(dropped: int, rows: int) -> str:
    return f"{dropped} of {rows} rows dropped: their time repeats the row before"


def _missing_values(dropped: int, rows: int, empty: Sequence[str]) -> str:
    everywhere = f", in all rows of {', '.join(empty)}" if empty else ""
    return f"{dropped} of {rows} rows dropped: a value is missing{everywhere}"


def _left_out(begin_s: float, end_s: float) -> str:
    return f"{begin_s:.3g} to {end_s:.3g} s left out: too short for the filters"


def _other_unit(column: str, unit: str) -> str:
    return f"{column} looks like {unit}: if so, say 'unit: {unit}' in the mapping"


def _cut_off(column: str, ends: Sequence[float]) -> str:
    at = " and ".join(f"{end:.4g}" for end in ends)
    return f"{column} is cut off at {at}: leave these times out, or raise the limit"


def _slow_source(column: str, rows: float, rate_hz: float) -> str:
    return f"{column} keeps each value for {rows:.2g} rows: its source is slower than the rows, {rate_hz:.3g} Hz"


NOTES: dict[str, Callable[..., str]] = {
    "no torque": lambda joints: f"no torque for {', '.join(joints)}",
    "signal of some joints": lambda signal: f"{signal} is not used: it is there for some joints only",
    "unused columns": lambda columns: f"columns not used: {', '.join(columns)}",
    "current as torque": _current_as_torque,
    "position jumps": _jumps,
    "torque peaks": _peaks,
    "velocity differs from dq/dt": _velocity_differs,
    "q_link equals q": lambda joint: f"q_link_{joint} is q_{joint} to the last digit and is not used",
    "q_link differs from q": _link_differs,
    "torque constant in motion": _torque_constant,
    "repeated times": _repeated_times,
    "missing values": _missing_values,
    "gaps in time": lambda pieces: f"gaps in time: {pieces} separate pieces, nothing is interpolated between them",
    "full turns unwrapped": lambda joints: f"full turns unwrapped: {', '.join(joints)}",
    "accelerations not used": lambda: "measured accelerations are not used: they come from the filtered positions",
    "constant torque": lambda joint: f"the torque of {joint} never changes and is not used",
    "left out": _left_out,
    "other unit": _other_unit,
    "cut off": _cut_off,
    "coarse steps": lambda column, step, steps: f"{column} has only {steps:.0f} steps of {step:.3g} in its range",
    "slow source": _slow_source,
    "constant column": lambda column: f"{column} never changes",
    "short recording": lambda seconds, least_s: (
        f"{seconds:.3g} s are short: {least_s:.0f} s are the least, minutes are better"
    ),
    "uneven times": lambda: "rows are unevenly spaced in time: they are interpolated",
}
"""By kind of remark, what says it; without a full stop."""


def _list(names: Sequence[str]) -> str:
    return as_many_as_fit(names, _WORDS)
