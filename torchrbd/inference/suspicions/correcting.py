"""What is suspected of a table, and the mapping entry that corrects it."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from typing import Any

from torch import Tensor

from torchrbd.inference.preparation import Prepared
from torchrbd.inference.suspicions.hypotheses import Hypothesis
from torchrbd.inference.suspicions.results import Meaning, Suspicion
from torchrbd.recordings.mapping import Source


def suspicion(
    h: Hypothesis, alike: Sequence[Hypothesis], log_odds: float, ratio: Tensor | None, prepared: Prepared
) -> Suspicion:
    """Return what is suspected.

    Args:
        h: the likeliest hypothesis.
        alike: others that the recordings cannot distinguish from it.
        log_odds: of it against a table that means what it says.
        ratio: (n_dof,) by which the squared error of each joint falls, NaN for one that is not judged; None where
            bodies show it and not the error.
        prepared: the data.
    """
    names = prepared.robot.joint_names
    joints = tuple(names[j] for j in h.joints)
    every = len(joints) == len(names) > 1
    times = math.nan
    if ratio is not None:
        own = ratio[list(h.joints)] if h.joints else ratio
        times = math.exp(float(own[own.isfinite()].log().mean())) if bool(own.isfinite().any()) else math.nan
    return Suspicion(
        h.kind,
        () if every and h.kind != "torque gain" else joints,
        log_odds,
        times,
        _meaning(h, prepared),
        sizes=_sizes(h, joints, prepared),
        names=_constants(h, joints, prepared),
        mapping=_mapping(h, joints, prepared),
        alternatives=tuple(dict.fromkeys(_meaning(one, prepared) for one in alike)),
    )


def too_fast(joints: Mapping[str, float]) -> Suspicion:
    """Return which joints move how many times as fast as the URDF allows, which no reading of the table mends."""
    odds = 2.0 * math.log(max(joints.values()))
    return Suspicion("speed", tuple(joints), odds, math.nan, Meaning("speed", tuple(joints)), sizes=dict(joints))


def _meaning(h: Hypothesis, prepared: Prepared) -> Meaning:
    names = prepared.robot.joint_names
    every = len(h.joints) == len(names) > 1 and not h.is_swap
    joints = () if every else tuple(names[j] for j in h.joints)
    gravity = tuple(h.writing.gravity) if h.kind == "gravity" else ()
    return Meaning(h.kind, joints, h.unit, gravity)


def _sizes(h: Hypothesis, joints: Sequence[str], prepared: Prepared) -> dict[str, float]:
    """Return the gain of each torque, or of all, and the rates of the clock as read and as meant [Hz]."""
    if h.kind == "torque gain":
        scale, names = h.writing.tau_scale, prepared.robot.joint_names
        if h.unit == "all":
            return {"all": 1.0 / abs(scale[0])}
        return {name: 1.0 / abs(scale[names.index(name)]) for name in joints}
    if h.kind == "time unit":
        rate = prepared.reading.surveys[0].rate_hz
        return {"as_read_hz": rate, "as_meant_hz": rate / h.writing.time}
    return {}


def _mapping(h: Hypothesis, joints: Sequence[str], prepared: Prepared) -> dict[str, Any]:
    """Return the entry of a mapping that corrects the table; empty where an option does."""
    if h.kind == "gravity":
        return {}
    if h.kind == "torque gain":
        return {"joints": generalise_entries(_currents(h, joints, prepared), prepared)}
    if h.kind == "time unit":
        column = source_of(prepared, "t", prepared.robot.joint_names[0]).column
        return {"time": {"column": column, "unit": h.unit}}
    entries: dict[str, dict[str, Any]] = {}
    for name, other in zip(joints, reversed(joints), strict=True):
        own = entries.setdefault(name, {})
        if h.kind in ("swapped torques", "swapped joints"):
            own["tau"] = entry_of(source_of(prepared, "tau", other))
        if h.kind in ("swapped positions", "swapped joints"):
            own["q"] = entry_of(source_of(prepared, "q", other))
        if h.unit:
            own["q"] = entry_of(source_of(prepared, "q", name), unit=h.unit)
        for signal, kinds in (("tau", ("torque sign", "direction")), ("q", ("position sign", "direction"))):
            if h.kind in kinds:
                own[signal] = entry_of(source_of(prepared, signal, name), turned=True)
    return {"joints": generalise_entries(entries, prepared)}


def _currents(h: Hypothesis, joints: Sequence[str], prepared: Prepared) -> dict[str, dict[str, Any]]:
    """Return the entries with which columns are currents, with the constants with which the torques fit."""
    names, entries = prepared.robot.joint_names, {}
    for joint in _measured(prepared) if h.unit == "all" else joints:
        source = source_of(prepared, "tau", joint)
        factor = h.writing.tau_scale[names.index(joint)]
        constant = float(f"{abs(source.scale * factor):.3g}")
        entry: dict[str, Any] = {"current": source.column, "torque_constant": constant}
        entry |= {"sign": -1} if source.scale * factor < 0 else {}
        entry |= {"offset": source.offset * factor} if source.offset else {}
        entries[joint] = {"tau": entry}
    return entries


def _constants(h: Hypothesis, joints: Sequence[str], prepared: Prepared) -> dict[str, str]:
    """Return by joint the constant with which a current would fit, or "unknown"; nothing for other kinds."""
    if h.kind != "torque gain":
        return {}
    sliding = dict(zip(prepared.robot.joint_names, prepared.robot.prismatic.tolist(), strict=True))
    found = {
        joint: f"{entry['tau']['torque_constant']:g} {'N' if sliding[joint] else 'N m'}/A"
        for joint, entry in _currents(h, joints, prepared).items()
    }
    return found | {joint: "unknown" for joint in _measured(prepared) if joint not in found}


def _measured(prepared: Prepared) -> list[str]:
    """Return the joints whose torque some recording has."""
    seen = [prepared.measured(k) for k in range(len(prepared.recordings))]
    return [name for j, name in enumerate(prepared.robot.joint_names) if any(bool(one[j]) for one in seen)]


def entry_of(source: Source, *, unit: str = "", turned: bool = False) -> dict[str, Any] | str:
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


def generalise_entries(entries: dict[str, dict[str, Any]], prepared: Prepared) -> dict[str, dict[str, Any]]:
    """Return one entry for all joints where the columns are called after them."""
    if len(entries) < 2 or len(entries) < prepared.robot.n_dof:
        return entries
    alike = {json.dumps(own).replace(f"_{name}", "_{joint}") for name, own in entries.items()}
    if len(alike) > 1:
        return entries
    name, own = next(iter(entries.items()))
    general = json.loads(json.dumps(own).replace(f"_{name}", "_{joint}"))
    return {"*": general}


def source_of(prepared: Prepared, signal: str, joint: str) -> Source:
    found = (recording.source(signal, joint) for recording in prepared.recordings)
    return next(filter(None, found), Source(f"{signal}_{joint}"))
