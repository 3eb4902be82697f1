"""Imports of optional libraries, for formats that not every user needs."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Any

from torchrbd.errors import RecordingError


def needed(module: str, extra: str, path: Path) -> Any:
    """Import the library that reads a file.

    Args:
        module: e.g. "rosbags.rosbag2".
        extra: of torchrbd, which installs it.
        path: the file.

    Raises:
        RecordingError: it is not installed; the message says how to install it.
    """
    try:
        return import_module(module)
    except ImportError:
        package = module.split(".")[0]
        raise RecordingError(
            f"{path}: to read it takes the package {package}, which is not installed: pip install {package} "
            f"(or torchrbd with its extra, {extra})"
        ) from None
