"""Tables whose columns are named by a tool in a known way."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace

from torchrbd.recordings.mapping import Mapping, Source
from torchrbd.recordings.ros_bags import chosen_topic

_PLOTJUGGLER = re.compile(r"(?P<topic>.+)/(?P<joint>[^/]+)/position")
_PLOTJUGGLER_FIELDS = {"q": "position", "qd": "velocity", "tau": "effort"}
_PLOTJUGGLER_TIME = "__time"


def with_layout(columns: Sequence[str], mapping: Mapping, place: str) -> Mapping:
    """Return a mapping that knows besides how a tool names columns, where it is such a table.

    PlotJuggler: ``__time`` and ``<topic>/<joint>/position``, ``.../velocity``, ``.../effort``. What the mapping names
    itself is left as it is.

    Args:
        columns: of the table.
        mapping: the user's.
        place: file or name, for messages.

    Raises:
        RecordingError: several topics of joint states, and the mapping does not say which.
    """
    if _PLOTJUGGLER_TIME not in columns:
        return mapping
    time = Source(_PLOTJUGGLER_TIME) if mapping.time == Source("t") and "t" not in columns else mapping.time
    mapping, every = replace(mapping, time=time), mapping.joints.get("*", {})
    topics: dict[str, int] = {}
    for found in filter(None, map(_PLOTJUGGLER.fullmatch, columns)):
        topics[found["topic"]] = topics.get(found["topic"], 0) + 1
    if not topics or "q" in every:
        return mapping
    topic = chosen_topic({name: f"{count} joints" for name, count in topics.items()}, mapping, place)
    fields = {key: Source(f"{topic}/{{joint}}/{field}") for key, field in _PLOTJUGGLER_FIELDS.items()}
    return replace(mapping, joints=mapping.joints | {"*": fields | every})
