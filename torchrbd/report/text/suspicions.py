"""What a table seems to mean instead of what it says, and what to do about it."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from typing import Any

from torchrbd.inference.suspicions.results import Meaning, Remedy, Suspicion
from torchrbd.report.text.numbers import as_many_as_fit, joined

# Below this factor it is not the torques that show it.
_CLEAR = 1.5
_WORDS = 10
_UNITS = {"deg": "degrees", "rad": "radians", "mm": "millimetres", "ms": "milliseconds", "us": "microseconds"}
_UNITS |= {"ns": "nanoseconds", "s": "seconds"}
_TESTED = {
    "degrees": "degrees for radians",
    "millimetres": "millimetres for metres",
    "time unit": "other units of time",
    "sign": "torques or positions of the opposite sign",
    "swapped columns": "columns of two joints exchanged",
    "gravity": "another direction of gravity",
    "torque gain": "currents or other units for torques",
    "clipped torque": "torques that are cut off",
    "variant": "the URDF of another variant",
    "late torque": "torques of an earlier or a later sample",
    "set-points": "set-points in degrees, of the opposite sign, or of another joint",
}


def tested_words(kinds: Sequence[str]) -> list[str]:
    """Return what was looked for, in words."""
    return [_TESTED.get(kind, kind) for kind in kinds]


def suspicion_statement(one: Suspicion) -> str:
    """Say the evidence, without a full stop."""
    words = _evidence(one)
    others = as_many_as_fit([_noun(other) for other in one.alternatives], _WORDS, "or", "others")
    return words + (f"; the recordings cannot distinguish this from {others}" if others else "")


def remedy_statement(remedy: Remedy) -> str:
    """Say what to do, with the entry for a mapping or the option."""
    one = remedy.suspicion
    if one.kind == "gravity":
        return f"if the robot is mounted so, or the URDF is upside down, give '--gravity {_vector(one.meaning)}'"
    if one.kind == "torque gain":
        return _currents(one)
    if one.kind == "speed":
        return "check the units of q and t, and the limits of the URDF; a '--mapping' sets other units"
    if one.kind == "late torque":
        return f"fits allow for it; if the table was written so, give --mapping a file with '{_yaml(one.mapping)}'"
    if one.kind == "clipped torque":
        return (
            f"empty {one.names['column']} in these rows (they are then not used), or record a motion with less torque"
        )
    if one.kind == "variant":
        return "is this the URDF of this robot's variant? If not, give that of the robot that was recorded"
    return f"if so, give --mapping a file with '{_yaml(one.mapping)}'"


def _currents(one: Suspicion) -> str:
    """Say what to do where torques may be currents."""
    constants: dict[str, list[str]] = {}
    for joint, constant in one.names.items():
        constants.setdefault(constant, []).append(joint)
    unknown = constants.pop("unknown", [])
    listed = ", ".join(f"{constant} at {', '.join(those)}" for constant, those in constants.items())
    more = f" (not identified: {', '.join(unknown)})" if unknown else ""
    return (
        f"if they are motor currents, the torques would fit with a constant, gear ratio included, of {listed}{more}: "
        f"give --mapping a file with '{_yaml(one.mapping)}'. This is a guess from the URDF's masses. Better write "
        "torque_constant and gear_ratio of the data sheet. If they are torques of another unit, write e.g. "
        "'unit: mN m'; if neither, check the masses of the URDF"
    )


def _set_points(one: Suspicion) -> str:
    """Say how much better joints follow other set-points than those that the table has."""
    where, follow = " and ".join(one.joints) or "all joints", "follow" if len(one.joints) != 1 else "follows"
    other = "each other's set-points" if one.kind == "swapped set-points" else one.kind
    return f"{where} {follow} {other}: with these the squared tracking error is {_number(one.times)} times smaller"


def _evidence(one: Suspicion) -> str:
    special = {"torque gain": _gain, "speed": _speed, "late torque": _late, "clipped torque": _clipped}
    special |= {"variant": _variant}
    if one.kind in special:
        return special[one.kind](one)
    if "set-points" in one.kind:
        return _set_points(one)
    joints, meaning = one.meaning.joints, _noun(one.meaning)
    if one.kind == "torque sign" and len(joints) == 1:
        return f"tau_{joints[0]} fits {_number(one.times)} times better with the opposite sign"
    if one.times > _CLEAR:
        subject = ", ".join(f"tau_{name}" for name in joints) or "the torques"
        return f"{subject} fit{'s' * (len(joints) == 1)} {_number(one.times)} times better with {meaning}"
    if one.kind == "time unit":
        read, meant = (_number(one.sizes[key]) for key in ("as_read_hz", "as_meant_hz"))
        return f"the sampling rate is {read} Hz as read, and {meant} Hz with {meaning}"
    return f"positions and speeds are far beyond the URDF's limits as read, but not with {meaning}"


def _noun(meaning: Meaning) -> str:
    """Return what the table would mean, as a noun."""
    kind, where = meaning.kind, " and ".join(meaning.joints) or "all joints"
    if kind in ("degrees", "radians", "millimetres"):
        return f"positions of {where} in {_UNITS[meaning.unit]}"
    if kind == "time unit":
        return f"times in {_UNITS[meaning.unit]}"
    if kind in ("torque sign", "position sign"):
        return f"{kind.split()[0]}s of {where} of the opposite sign"
    if kind == "direction":
        return f"positions and torques of {where} of the opposite sign"
    if kind == "gravity":
        return f"gravity along {_vector(meaning)}"
    columns = {"swapped torques": "torques", "swapped positions": "positions", "swapped joints": "columns"}[kind]
    return f"{columns} of {where} exchanged"


def _gain(one: Suspicion) -> str:
    if "all" in one.sizes:
        return f"the torques of all joints have the URDF's shape, but {_number(one.sizes['all'])} times its size"
    sizes = [f"{name} {_number(size)} times" for name, size in one.sizes.items()]
    return f"torques have the URDF's shape, but another size: {as_many_as_fit(sizes, _WORDS)}"


def _speed(one: Suspicion) -> str:
    sizes = [f"{name} {times:.3g} times" for name, times in one.sizes.items()]
    return f"joints move faster than the URDF allows: {as_many_as_fit(sizes, _WORDS)}"


def _late(one: Suspicion) -> str:
    number, delay, std = (one.sizes[key] for key in ("samples", "delay_s", "delay_std_s"))
    count, way = f"{abs(number):.0f} sample{'s' * (abs(number) > 1)}", "later" if number > 0 else "earlier"
    return f"the torques are {count} {way} than the motion ({1e3 * abs(delay):.3g} ± {1.96e3 * std:.2g} ms)"


def _clipped(one: Suspicion) -> str:
    size, unit = one.sizes, one.meaning.unit
    known = ", the URDF's effort limit," if size["is_effort_limit"] else ""
    return (
        f"{one.names['column']} is cut off at {size['limit']:.4g} {unit}{known} in {100 * size['share']:.2g} % of its "
        f"rows; the motion there needs {size['beyond']:.2g} {unit} more on average"
    )


def _variant(one: Suspicion) -> str:
    lengths = [
        f"{name} {one.sizes[name]:.2g} m from the origin of {parent} instead of {one.sizes[f'{name}, URDF']:.2g} m"
        for name, parent in one.names.items()
    ]
    return f"the torques fit {one.times:.2g} times better with other link lengths: {joined(lengths)}"


def _yaml(value: Any) -> str:
    """Return YAML on one line."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{_key(key)}: {_yaml(entry)}" for key, entry in value.items()) + "}"
    return _key(value) if isinstance(value, str) else str(value)


def _key(text: str) -> str:
    plain = text.replace("_", "").isalnum() and not text[0].isdigit()
    return text if plain else json.dumps(text, ensure_ascii=False)


def _vector(meaning: Meaning) -> str:
    return " ".join(f"{x:.4g}" for x in meaning.gravity)


def _number(value: float) -> str:
    if not math.isfinite(value):
        return "many"
    return f"{value:.2g}" if 1e-3 <= value < 100 else f"{value:.0f}" if value < 1e5 and value >= 100 else f"{value:.1e}"
