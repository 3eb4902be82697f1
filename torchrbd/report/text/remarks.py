"""Remarks: what a user should know of the input or of a result."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from torchrbd.display import Remark
from torchrbd.report.text.export import EXPORTED
from torchrbd.report.text.identification import DOUBTS
from torchrbd.report.text.inputs import FACTS
from torchrbd.report.text.motions import MOTIONS
from torchrbd.report.text.numbers import as_many_as_fit
from torchrbd.report.text.recordings import NOTES

_WORDS = 8


def remark_statement(remark: Remark) -> str:
    """Say a remark."""
    words = _WORDS_OF[remark.kind](**remark.values)
    return f"{remark.recording}: {words}" if remark.recording else words


def _same_recordings(recordings: list[str]) -> str:
    names = as_many_as_fit(recordings, _WORDS)
    return f"both diagnoses used recordings named {names}; if the files are the same, nothing can have changed"


def _other_cutoff(before_hz: float, after_hz: float) -> str:
    return f"the cutoffs differ ({before_hz:g} and {after_hz:g} Hz); diagnose both with the same --cutoff"


_WORDS_OF: dict[str, Callable[..., str]] = {
    **DOUBTS,
    **NOTES,
    **FACTS,
    **MOTIONS,
    **EXPORTED,
    "same recordings": _same_recordings,
    "other cutoff": _other_cutoff,
    "one simulated": lambda: "one was compared with a simulation, the other with the URDF; these may differ too",
    "inertia not compared": lambda: (
        "inertial parameters are not compared: parameters.json is missing, lacks intervals, or has other bodies"
    ),
    "no detection limits": lambda: "one of the two has no detection limits; diagnose its recordings again",
}


def kinds() -> dict[str, Callable[..., Any]]:
    """Return the remarks that are known, by kind."""
    return dict(_WORDS_OF)
