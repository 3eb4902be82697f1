"""Parse, run the command, answer what cannot be used; what is imported before a command is chosen is light."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from contextlib import suppress

from cyclopts.exceptions import CycloptsError, MissingArgumentError
from rich.console import Console

from torchrbd.cli.app import app
from torchrbd.cli.terminal import fall_silent, speak_plainly
from torchrbd.errors import TorchRBDError

UNUSABLE = 2
"""Exit code for input that cannot be used."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code."""
    speak_plainly()
    try:
        return _run(sys.argv[1:] if arguments is None else list(arguments))
    finally:
        fall_silent()


def _run(arguments: list[str]) -> int:
    errors = Console(stderr=True, highlight=False, soft_wrap=True)
    code = UNUSABLE
    # Who listens to errors may have gone too; rich exits then.
    with suppress(OSError):
        try:
            code = _command(arguments)
        except (TorchRBDError, OSError, CycloptsError) as error:
            with suppress(SystemExit):
                errors.print("torchrbd: error:", style="bold red", end=" ")
                errors.print(_words(error), markup=False)
        except KeyboardInterrupt:
            code = 130
            errors.print("torchrbd: interrupted")
    return code


def _command(arguments: list[str]) -> int:
    """Run what was asked for, with the exit code of work that is done."""
    # Results are written before they are shown: who closes a pipe has seen enough. rich exits where nobody reads.
    with suppress(BrokenPipeError, SystemExit):
        app()(arguments, exit_on_error=False, print_error=False, result_action="return_value")
        sys.stdout.flush()
    return 0 if arguments else UNUSABLE


def _words(error: Exception) -> str:
    """Return what an error says, and what to do where an option with several values has taken the files after it."""
    if isinstance(error, MissingArgumentError) and error.argument is not None and error.argument.is_positional_only():
        return f"{str(error).rstrip('.')}; give the files first: options that take several values take all that follows"
    return str(error)
