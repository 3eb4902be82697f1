"""Terminals that cannot show every character, and pipes that nobody reads any more."""

from __future__ import annotations

import codecs
import io
import os
import sys
import unicodedata
from contextlib import suppress

_PLAIN = {
    "±": "+/-", "\N{MINUS SIGN}": "-", "–": "-", "→": "->", "·": "*", "°": "deg", "≠": "!=", "✓": "ok", "✗": "x",
    "\N{NO-BREAK SPACE}": " ", "\N{NARROW NO-BREAK SPACE}": " ", "⁻": "-", "…": "...",
}  # fmt: skip
"""Replaces characters that a terminal's encoding lacks."""


def _plainly(error: UnicodeError) -> tuple[str, int]:
    """Return what to write instead of characters that cannot be written, and where to go on."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    found = []
    for letter in error.object[error.start : error.end]:
        simple = _PLAIN.get(letter) or unicodedata.normalize("NFKD", letter).encode("ascii", "ignore").decode()
        found.append(simple or "?")
    return "".join(found), error.end


codecs.register_error("torchrbd_plainly", _plainly)


def speak_plainly() -> None:
    """Let the standard streams write what their encoding lacks in other characters instead of failing."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper) and stream.errors in ("strict", "surrogateescape"):
            stream.reconfigure(errors="torchrbd_plainly")


def fall_silent() -> None:
    """Discard output that is not written yet: Python would fail on it once more when it ends."""
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except (OSError, ValueError):
            with suppress(OSError, ValueError):
                os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
