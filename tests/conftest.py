"""Kernels are built anew by each session of tests, once for all of its processes."""

from __future__ import annotations

import os
import shutil
import tempfile

import pytest

_MADE: list[str] = []


def pytest_configure(config: pytest.Config) -> None:
    # Workers of pytest-xdist inherit what the session that started them has set.
    if not hasattr(config, "workerinput"):
        _MADE.append(tempfile.mkdtemp(prefix="torchrbd-kernels-"))
        os.environ["TORCHRBD_CACHE"] = _MADE[0]


def pytest_unconfigure() -> None:
    for folder in _MADE:
        shutil.rmtree(folder, ignore_errors=True)
