"""Options in YAML: those of ``--config``, and those of a robot in the list of a fleet."""

from __future__ import annotations

from typing import Any

from torchrbd.errors import OptionError, closest
from torchrbd.inference.settings import Settings
from torchrbd.options import Options, spelt
from torchrbd.recordings.strict_yaml import line_of

# As a file may have them, the names of Python too.
_NAMES = {**{name: name for name in Options.names()}, **{spelt(name): name for name in Options.names()}}
_NAMES |= {spelt(name).replace("-", "_"): name for name in Options.names()}


def read_options(content: Any, place: str) -> dict[str, Any]:
    """Return options by the names of Python, checked.

    Args:
        content: of the file or of a part of it, as of ``strict_yaml``.
        place: the file, for errors.

    Raises:
        OptionError: no mapping, an unknown option, or a value that cannot be; names the line.
    """
    if not isinstance(content, dict):
        raise OptionError(f"{place}: expected 'option: value' lines, e.g. 'cutoff: 5'; got {content!r:.50}")
    found: dict[str, Any] = {}
    for key, value in content.items():
        line = line_of(content, (key,))
        here = f"{place}: line {line}" if line else place
        name = _NAMES.get(key) if isinstance(key, str) else None
        if name is None:
            known = sorted(spelt(name) for name in Options.names())
            hint = closest(str(key), known) or f"known: {', '.join(known)}"
            raise OptionError(f"{here}: unknown option '{key}'; {hint}")
        if name in found:
            raise OptionError(f"{here}: '{key}' is given twice, as {spelt(name)} and {name}; leave one out")
        found[name] = value
        try:
            Settings.from_mapping({name: value}, here)
        except OptionError as error:
            raise OptionError(str(error) if str(error).startswith(here) else f"{here}: {error}") from None
    return found
