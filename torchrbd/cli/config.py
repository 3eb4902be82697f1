"""The options that the command line and its configuration file give."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from torchrbd.errors import OptionError
from torchrbd.inference import Settings
from torchrbd.inference.options_file import read_options
from torchrbd.options import Options
from torchrbd.recordings.checked_yaml import read_yaml

# Options that name files.
_FILES = {"holdout", "simulated", "mapping"}


def chosen(config: Path | None, options: Mapping[str, Any], used: Sequence[str] = Options.names()) -> dict[str, Any]:
    """Return the options that were given: those of the configuration file, then those of the command line.

    Args:
        config: the file; it may have options of other commands, too, so that one file does for several.
        options: of the command line, None where one was not given.
        used: the options that the command has.
    """
    read = _read_config(config) if config is not None else {}
    return {name: value for name, value in read.items() if name in used} | {
        name: value for name, value in options.items() if value is not None
    }


def _read_config(path: Path) -> dict[str, Any]:
    content = read_yaml(path, "cannot be read ({reason}); check --config", OptionError)
    chosen, folder = read_options(content, str(path)), path.parent
    read = Settings.from_mapping(chosen, str(path))
    for key in _FILES & chosen.keys():
        files = getattr(read, key)
        chosen[key] = [folder / file for file in files] if isinstance(files, tuple) else files and folder / files
    return chosen
