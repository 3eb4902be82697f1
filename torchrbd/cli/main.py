"""Parse, run the command, answer what cannot be used; what is imported before a command is chosen is light."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console

from torchrbd.cli.options import parser
from torchrbd.errors import OptionError, TorchRBDError


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code."""
    options = parser().parse_args(arguments)
    errors = Console(stderr=True, highlight=False, soft_wrap=True)
    try:
        if options.output is not None:
            _check_output(options.output)
        # The packages that do the work take seconds to import, for which no --help is to wait.
        from torchrbd.cli.commands import COMMANDS

        COMMANDS[options.command](options)
    except (TorchRBDError, OSError) as error:
        errors.print("torchrbd: error:", style="bold red", end=" ")
        errors.print(str(error), markup=False)
        return 2
    except KeyboardInterrupt:
        errors.print("torchrbd: interrupted")
        return 130
    return 0


def _check_output(folder: Path) -> None:
    """Refuse, before any work is done, a folder that cannot be written."""
    existing = next(path for path in (folder, *folder.absolute().parents) if path.exists())
    if not existing.is_dir() or not os.access(existing, os.W_OK):
        raise OptionError(f"output '{folder}': '{existing}' is not a folder that can be written; name another")
