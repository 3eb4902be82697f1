"""Tables whose columns are named by a tool in a known way."""

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
    """Return a mapping that knows besides how a tool names columns, where it is such a table.

    PlotJuggler: ``__time`` and ``<topic>/<joint>/position``, ``.../velocity``, ``.../effort``. LeRobot: positions are
    ``observation.state/<joint>`` or ``observation.state/<joint>.pos``; velocities and efforts are those of
    ``observation.velocity`` and ``observation.effort``, or have the endings .vel and .effort. What the mapping names
    itself is left as it is.

    Args:
        columns: of the table.
        mapping: the user's.
        place: file or name, for messages.

    Raises:
        RecordingError: several topics of joint states, and the mapping does not say which.
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
    """Return the columns' names by signal; none where the mapping has positions itself."""
    topics: dict[str, int] = {}
    for found in filter(None, map(_PLOTJUGGLER.fullmatch, columns)):
        topics[found["topic"]] = topics.get(found["topic"], 0) + 1
    if not topics or "q" in mapping.joints.get("*", {}):
        return {}
    topic = chosen_topic({name: f"{count} joints" for name, count in topics.items()}, mapping, place)
    return {key: f"{topic}/{{joint}}/{field}" for key, field in _PLOTJUGGLER_FIELDS.items()}


def _of_lerobot(columns: Sequence[str]) -> dict[str, str]:
    """Return the columns' names by signal, of those that are there."""
    states = [name[len(_LEROBOT) :] for name in columns if name.startswith(_LEROBOT)]
    if not states:
        return {}
    ending = ".pos" if any(name.endswith(".pos") for name in states) else ""
    joints = [name.removesuffix(ending) for name in states if name.endswith(ending)]
    found = {"q": f"{_LEROBOT}{{joint}}{ending}"}
    for signal, feature, own in (("qd", "observation.velocity", ".vel"), ("tau", "observation.effort", ".effort")):
        patterns = [f"{_LEROBOT}{{joint}}{own}", *(f"{feature}/{{joint}}{end}" for end in ("", own, ending))]
        there = [p for p in patterns if any(p.replace("{joint}", joint) in columns for joint in joints)]
        found |= {signal: there[0]} if there else {}
    return found
