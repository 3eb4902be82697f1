"""Exception classes. Messages say what was expected, what was found, where, and the remedy."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class TorchRBDError(Exception):
    """Base class of all exceptions that torchrbd raises on purpose."""


class InputError(TorchRBDError, ValueError):
    """Input that cannot be used. The message names the place and the remedy; the command line exits with code 2."""


class RobotError(InputError):
    """A robot description that cannot be used: names the file, the link or joint, and the remedy."""


class RecordingError(InputError):
    """A recording or mapping that cannot be used: names the file, the column or row, and the remedy."""


class OptionError(InputError):
    """An option that does not fit the robot or the recordings."""


class PhysicalError(TorchRBDError, ValueError):
    """Inertial parameters that no rigid body can have, in a computation that needs physical ones."""


class UnfinishedError(TorchRBDError):
    """Work that was not begun or not ended, since the user asked for an early end."""


def closest(name: str, known: Iterable[str]) -> str:
    """Return "did you mean 'x'?" for the most similar known name; empty if none is similar."""
    alike = difflib.get_close_matches(name, list(known), n=1)
    return f"did you mean '{alike[0]}'?" if alike else ""


def reason(error: Exception) -> str:
    """Return the message of an expected error; of any other, its type and message."""
    return str(error) if isinstance(error, TorchRBDError | OSError) else f"{type(error).__name__}: {error}"
