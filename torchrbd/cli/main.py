"""Parse, run the command, answer what cannot be used; what is imported before a command is chosen is light."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from contextlib import suppress

from rich.console import Console

from torchrbd.cli.options import parser
from torchrbd.cli.terminal import fall_silent, speak_plainly
from torchrbd.errors import TorchRBDError


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code."""
    speak_plainly()
    try:
        return _run(arguments)
    finally:
        fall_silent()


def _run(arguments: Sequence[str] | None) -> int:
    errors = Console(stderr=True, highlight=False, soft_wrap=True)
    code = 2
    # Who listens to errors may have gone too; rich exits then.
    with suppress(OSError):
        try:
            options = parser().parse_args(arguments)
            code = _command(options)
        except (TorchRBDError, OSError) as error:
            with suppress(SystemExit):
                errors.print("torchrbd: error:", style="bold red", end=" ")
                errors.print(str(error), markup=False)
        except KeyboardInterrupt:
            code = 130
            errors.print("torchrbd: interrupted")
    return code


def _command(options: argparse.Namespace) -> int:
    """Run what was asked for, with the exit code of work that is done."""
    # The packages that do the work take seconds to import, for which no --help is to wait.
    from torchrbd.cli.commands import COMMANDS

    # Results are written before they are shown: who closes a pipe has seen enough. rich exits where nobody reads.
    with suppress(BrokenPipeError, SystemExit):
        COMMANDS[options.command](options)
        sys.stdout.flush()
    return 0
