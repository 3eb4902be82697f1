"""Tables with the column names of a known tool."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace

from torchrbd.recordings.mapping import Mapping, Source, chosen_topic

_PLOTJUGGLER = re.compile(r"(?P<topic>.+)/(?P<joint>[^/]+)/position")
_PLOTJUGGLER_FIELDS = {"q": "position", "qd": "velocity", "tau": "effort"}
_PLOTJUGGLER_TIME = "__time"
_LEROBOT = "observation.state/"


def with_layout(columns: Sequence[str], mapping: Mapping, place: str) -> Mapping:
    """Return a mapping completed with the column names of a known tool, if the table comes from one.

    PlotJuggler: ``__time`` and ``<topic>/<joint>/position``, ``.../velocity``, ``.../effort``. LeRobot: positions are
    ``observation.state/<joint>`` or ``observation.state/<joint>.pos``; velocities and efforts are in
    ``observation.velocity`` and ``observation.effort``, or have the endings .vel and .effort. Set-points are
    ``action/<joint>`` or ``action/<joint>.pos``. Entries of the given mapping take precedence.

    Args:
        columns: of the table.
        mapping: the user's.
        place: file or name, for messages.

    Raises:
        RecordingError: several topics have joint states, and the mapping does not choose one.
    """
    if _PLOTJUGGLER_TIME in columns:
        fields = _of_plotjuggler(columns, mapping, place)
        if mapping.time == Source("t") and "t" not in columns:
            mapping = replace(mapping, time=Source(_PLOTJUGGLER_TIME))
    else:
        fields = _of_lerobot(columns)
    every = {key: Source(name) for key, name in fields.items()} | mapping.joints.get("*", {})
    return replace(mapping, joints=mapping.joints | {"*": every}) if every else mapping


def _of_plotjuggler(columns: Sequence[str], mapping: Mapping, place: str) -> dict[str, str]:
    """Return the columns' names by signal; none if the mapping itself has positions."""
    topics: dict[str, int] = {}
    for found in filter(None, map(_PLOTJUGGLER.fullmatch, columns)):
        topics[found["topic"]] = topics.get(found["topic"], 0) + 1
    if not topics or "q" in mapping.joints.get("*", {}):
        return {}
    topic = chosen_topic({name: f"{count} joints" for name, count in topics.items()}, mapping, place)
    return {key: f"{topic}/{{joint}}/{field}" for key, field in _PLOTJUGGLER_FIELDS.items()}


def _of_lerobot(columns: Sequence[str]) -> dict[str, str]:
    """Return the names of the existing columns by signal."""
    states = [name[len(_LEROBOT) :] for name in columns if name.startswith(_LEROBOT)]
    if not states:
        return {}
    ending = ".pos" if any(name.endswith(".pos") for name in states) else ""
    joints = [name.removesuffix(ending) for name in states if name.endswith(ending)]
    found = {"q": f"{_LEROBOT}{{joint}}{ending}"}
    for signal, feature, own in (("qd", "observation.velocity", ".vel"), ("tau", "observation.effort", ".effort")):
        patterns = [f"{_LEROBOT}{{joint}}{own}", *(f"{feature}/{{joint}}{end}" for end in ("", own, ending))]
        there = [p for p in patterns if _any(p, joints, columns)]
        found |= {signal: there[0]} if there else {}
    actions = [p for p in (f"action/{{joint}}{end}" for end in (ending, "")) if _any(p, joints, columns)]
    return found | ({"q_ref": actions[0]} if actions else {})


def _any(pattern: str, joints: Sequence[str], columns: Sequence[str]) -> bool:
    return any(pattern.replace("{joint}", joint) in columns for joint in joints)
