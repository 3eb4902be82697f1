"""What a user gives as recordings: files, opened ones, or data in memory, one of them or several."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from torchrbd.errors import RecordingError
from torchrbd.recordings.memory import Data, InMemory, is_data
from torchrbd.recordings.recording import Recording

RecordingSource = str | Path | Recording | Data
"""What a recording is taken from, see ``open_recording``."""
Sources = Sequence[RecordingSource] | RecordingSource
"""One or several."""
NamedSource = Path | Recording | InMemory
"""The same with a name."""


def listed_sources(given: Any, word: str = "recording") -> list[NamedSource]:
    """Return one source or several as a list; those in memory are called by their place in it, "recording 1".

    Args:
        given: a source or an iterable of them; None is none.
        word: what the sources are.

    Raises:
        RecordingError: something that no recording can be taken from.
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
