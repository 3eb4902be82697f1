"""Recordings as a user gives them: files, opened recordings or data in memory, one or several."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from torchrbd.errors import RecordingError
from torchrbd.recordings.memory import Data, InMemory, is_data
from torchrbd.recordings.recording import Recording

RecordingSource = str | Path | Recording | Data
"""Anything that ``open_recording`` accepts, or an opened recording."""
Sources = Sequence[RecordingSource] | RecordingSource
"""One or several."""
NamedSource = Path | Recording | InMemory
"""A source with a name."""


def listed_sources(given: Any, word: str = "recording") -> list[NamedSource]:
    """Return one or several sources as a list; those in memory are named by their position, "recording 1".

    Args:
        given: a source or an iterable of them; None gives an empty list.
        word: the name of a source in messages.

    Raises:
        RecordingError: an object that cannot be a recording.
    """
    if given is None:
        return []
    several = isinstance(given, Iterable) and not (isinstance(given, (str, Path, Recording)) or is_data(given))
    sources: Any = given if several else [given]
    found: list[NamedSource] = []
    for k, source in enumerate(sources, start=1):
        if isinstance(source, (Recording, InMemory)):
            found.append(source)
        elif isinstance(source, (str, Path)):
            found.append(Path(source))
        elif is_data(source):
            found.append(InMemory(f"{word} {k}", source))
        else:
            raise RecordingError(
                f"{word} {k} is of type {type(source).__name__}; expected a file, a torchrbd.Recording, a table "
                "such as a pandas.DataFrame, or a dict of arrays"
            )
    return found
