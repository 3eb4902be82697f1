"""The settings that the command line and its configuration file give."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import yaml

from torchrbd.errors import OptionError
from torchrbd.inference import Settings
from torchrbd.recordings.strict_yaml import strict_yaml

# Options that name files.
_FILES = {"holdout", "simulated", "mapping"}


def settings_of(options: argparse.Namespace) -> dict[str, Any]:
    """Return the options that were given: those of the configuration file, then those of the command line."""
    chosen = _read_config(options.config) if options.config else {}
    given = {name: value for name, value in vars(options).items() if name in Settings.names() and value is not None}
    return chosen | given


def _read_config(path: Path) -> dict[str, Any]:
    try:
        content = strict_yaml(path.read_text(encoding="utf-8"))
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise OptionError(f"{path}: is not YAML in UTF-8 ({' '.join(str(error).split())})") from None
    except OSError as error:
        raise OptionError(f"{path}: cannot be read ({error.strerror}); check --config") from None
    if not isinstance(content, dict):
        raise OptionError(f"{path}: expected 'option: value' lines, e.g. 'cutoff: 5'")
    chosen = {str(key).replace("-", "_"): value for key, value in content.items()}
    if "cutoff" in chosen:
        chosen["cutoff_hz"] = chosen.pop("cutoff")
    read = Settings.from_mapping(chosen, str(path))
    folder = path.parent
    for key in _FILES & chosen.keys():
        files = getattr(read, key)
        chosen[key] = [folder / file for file in files] if isinstance(files, tuple) else files and folder / files
    return chosen
