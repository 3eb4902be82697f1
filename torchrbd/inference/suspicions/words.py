"""Suspicions in words: the evidence, and the mapping entry or option that corrects the table."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from typing import Any

from torch import Tensor

from torchrbd.inference.preparation import Prepared
from torchrbd.inference.suspicions.hypotheses import Hypothesis
from torchrbd.inference.suspicions.results import Suspicion
from torchrbd.recordings.mapping import Source

# Below this factor it is not the torques that tell.
_TELLING = 1.5
_UNITS = {"deg": "degrees", "rad": "radians", "mm": "millimetres", "ms": "milliseconds", "us": "microseconds"}
_UNITS |= {"ns": "nanoseconds", "s": "seconds"}


def told(
    h: Hypothesis, alike: Sequence[Hypothesis], log_odds: float, ratio: Tensor | None, prepared: Prepared
) -> Suspicion:
    """Say what is suspected.

    Args:
        h: the likeliest hypothesis.
        alike: others that the recordings do not tell from it.
        log_odds: of it against a table that means what it says.
        ratio: (n_dof,) by which the squared error of each joint falls, NaN for one that is not judged; None where
            bodies tell and not the error.
        prepared: the data.
    """
    names = prepared.robot.joint_names
    joints = tuple(names[j] for j in h.joints)
    every = len(joints) == len(names) > 1
    times = math.nan
    if ratio is not None:
        own = ratio[list(h.joints)] if h.joints else ratio
        times = math.exp(float(own[own.isfinite()].log().mean())) if bool(own.isfinite().any()) else math.nan
    others = tuple(dict.fromkeys(_meaning(one, tuple(names[j] for j in one.joints), len(names)) for one in alike))
    statement = _evidence(h, joints, times, prepared)
    if others:
        statement += f"; these recordings do not tell that from {' or '.join(others)}"
    return Suspicion(
        h.kind, () if every and h.kind != "torque gain" else joints, log_odds, times, statement,
        _remedy(h, joints, prepared), alternatives=others,
    )  # fmt: skip


def too_fast(joints: Mapping[str, float]) -> Suspicion:
    """Say which joints move how many times as fast as the URDF allows, which no reading of the table mends."""
    listed = ", ".join(f"{name} {times:.3g} times" for name, times in joints.items())
    odds = 2.0 * math.log(max(joints.values()))
    return Suspicion(
        "speed", tuple(joints), odds, math.nan, f"joints move faster than the URDF allows, {listed}",
        "check the units of q and t, and the limits of the URDF; '--mapping' names other units",
    )  # fmt: skip


def _meaning(h: Hypothesis, joints: Sequence[str], n_dof: int) -> str:
    """Return what the table would mean, as a noun."""
    all_alike = len(joints) == n_dof > 1 and not h.kind.startswith("swapped")
    where = "all joints" if all_alike else " and ".join(joints)
    if h.kind in ("degrees", "radians", "millimetres"):
        return f"positions of {where} in {_UNITS[h.unit]}"
    if h.kind == "time unit":
        return f"times in {_UNITS[h.unit]}"
    if h.kind in ("torque sign", "position sign"):
        return f"{h.kind.split()[0]}s of {where} of the opposite sign"
    if h.kind == "direction":
        return f"positions and torques of {where} of the opposite sign"
    if h.kind == "gravity":
        return f"gravity along {_vector(h)}"
    columns = {"swapped torques": "torques", "swapped positions": "positions", "swapped joints": "columns"}[h.kind]
    return f"{columns} of {where} exchanged"


def _evidence(h: Hypothesis, joints: Sequence[str], times: float, prepared: Prepared) -> str:
    n_dof = prepared.robot.n_dof
    if h.kind == "torque gain":
        return _gain(h, joints, prepared)
    meaning = _meaning(h, joints, n_dof)
    if h.kind == "torque sign" and len(joints) == 1 and n_dof > 1:
        return f"tau_{joints[0]} fits {_number(times)} times better with the opposite sign"
    if times > _TELLING:
        subject = ", ".join(f"tau_{name}" for name in joints) if 0 < len(joints) < n_dof else "the torques"
        return (
            f"{subject} fit{'' if len(joints) != 1 or n_dof == 1 else 's'} {_number(times)} times better with {meaning}"
        )
    if h.kind == "time unit":
        rate = prepared.reading.surveys[0].rate_hz
        clock = rate / h.writing.time
        return f"the clock ticks {_number(rate)} times a second as it stands, and {_number(clock)} times with {meaning}"
    return f"positions and speeds are far beyond the URDF's limits as they stand, and not with {meaning}"


def _gain(h: Hypothesis, joints: Sequence[str], prepared: Prepared) -> str:
    scale = h.writing.tau_scale
    names = prepared.robot.joint_names
    if h.unit == "all":
        size = _number(1.0 / abs(scale[0]))
        return f"the torques of all joints have the shape of the URDF's and {size} times their size"
    sizes = (f"{name} {_number(1.0 / abs(scale[names.index(name)]))}" for name in joints)
    return f"torques have the shape of the URDF's and another size, in multiples of it: {', '.join(sizes)}"


def _remedy(h: Hypothesis, joints: Sequence[str], prepared: Prepared) -> str:
    """Return what to do, with the entry for a mapping or the option."""
    if h.kind == "gravity":
        return f"if the robot is mounted so, or the URDF upside down, give '--gravity {_vector(h)}'"
    if h.kind == "torque gain":
        return _currents(h, joints, prepared)
    if h.kind == "time unit":
        column = _source(prepared, "t", prepared.robot.joint_names[0]).column
        return f"if so, give --mapping a file with '{_yaml({'time': {'column': column, 'unit': h.unit}})}'"
    entries: dict[str, dict[str, Any]] = {}
    for name, other in zip(joints, reversed(joints), strict=True):
        own = entries.setdefault(name, {})
        if h.kind in ("swapped torques", "swapped joints"):
            own["tau"] = _entry(_source(prepared, "tau", other))
        if h.kind in ("swapped positions", "swapped joints"):
            own["q"] = _entry(_source(prepared, "q", other))
        if h.unit:
            own["q"] = _entry(_source(prepared, "q", name), unit=h.unit)
        for signal, kinds in (("tau", ("torque sign", "direction")), ("q", ("position sign", "direction"))):
            if h.kind in kinds:
                own[signal] = _entry(_source(prepared, signal, name), turned=True)
    return f"if so, give --mapping a file with '{_yaml({'joints': _general(entries, prepared)})}'"


def _currents(h: Hypothesis, joints: Sequence[str], prepared: Prepared) -> str:
    """Return what to do where torques may be currents: the constants with which they fit, as a mapping has them."""
    names, prismatic = prepared.robot.joint_names, prepared.robot.prismatic.tolist()
    seen = [prepared.measured(k) for k in range(len(prepared.recordings))]
    measured = [name for j, name in enumerate(names) if any(bool(one[j]) for one in seen)]
    joints = measured if h.unit == "all" else joints
    entries, constants = {}, dict[str, list[str]]()
    for joint in joints:
        source, j = _source(prepared, "tau", joint), names.index(joint)
        factor = h.writing.tau_scale[j]
        constant = float(f"{abs(source.scale * factor):.3g}")
        entry: dict[str, Any] = {"current": source.column, "torque_constant": constant}
        entry |= {"sign": -1} if source.scale * factor < 0 else {}
        entry |= {"offset": source.offset * factor} if source.offset else {}
        entries[joint] = {"tau": entry}
        constants.setdefault(f"{constant:g} {'N' if prismatic[j] else 'N m'}/A", []).append(joint)
    told = ", ".join(f"{constant} at {', '.join(those)}" for constant, those in constants.items())
    if others := [name for name in measured if name not in joints]:
        told += f" (these recordings do not show that of {', '.join(others)})"
    return (
        f"if they are motor currents, the torques would fit with a constant, gear ratio included, of {told}: give "
        f"--mapping a file with '{_yaml({'joints': _general(entries, prepared)})}'. That is a guess from the URDF's "
        "masses: better write torque_constant and gear_ratio of the data sheet. If they are torques of another unit, "
        "write e.g. 'unit: mN m'; if neither, check the masses of the URDF"
    )


def _entry(source: Source, *, unit: str = "", turned: bool = False) -> dict[str, Any] | str:
    """Return the entry of a mapping that reads a column as it is read now, but for its unit or its direction."""
    scale = math.copysign(1.0, source.scale) if unit else source.scale
    scale, offset = (-scale, -source.offset) if turned else (scale, source.offset)
    entry: dict[str, Any] = {"column": source.column} | ({"unit": unit} if unit else {})
    if abs(scale) != 1.0:
        entry["scale"] = scale
    elif turned or scale < 0:
        entry["sign"] = int(scale)
    if offset:
        entry["offset"] = offset
    return entry if len(entry) > 1 else source.column


def _general(entries: dict[str, dict[str, Any]], prepared: Prepared) -> dict[str, dict[str, Any]]:
    """Return one entry for all joints where the columns are called after them."""
    if len(entries) < 2 or len(entries) < prepared.robot.n_dof:
        return entries
    alike = {_yaml(own).replace(f"_{name}", "_{joint}") for name, own in entries.items()}
    if len(alike) > 1:
        return entries
    name, own = next(iter(entries.items()))
    general = json.loads(json.dumps(own).replace(f"_{name}", "_{joint}"))
    return {"*": general}


def _source(prepared: Prepared, signal: str, joint: str) -> Source:
    found = (recording.source(signal, joint) for recording in prepared.recordings)
    return next(filter(None, found), Source(f"{signal}_{joint}"))


def _yaml(value: Any) -> str:
    """Return YAML on one line."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{_key(key)}: {_yaml(entry)}" for key, entry in value.items()) + "}"
    return _key(value) if isinstance(value, str) else str(value)


def _key(text: str) -> str:
    plain = text.replace("_", "").isalnum() and not text[0].isdigit()
    return text if plain else json.dumps(text, ensure_ascii=False)


def _vector(h: Hypothesis) -> str:
    return " ".join(f"{x:.4g}" for x in h.writing.gravity)


def _number(value: float) -> str:
    if not math.isfinite(value):
        return "many"
    return f"{value:.2g}" if 1e-3 <= value < 100 else f"{value:.0f}" if value < 1e5 and value >= 100 else f"{value:.1e}"
