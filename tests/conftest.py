"""Kernels are built anew by each session of tests, once for all of its processes."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import nullcontext

import pytest
import shortened

_MADE: list[str] = []


def pytest_configure(config: pytest.Config) -> None:
    # Workers of pytest-xdist inherit what the session that started them has set.
    if not hasattr(config, "workerinput"):
        _MADE.append(tempfile.mkdtemp(prefix="torchrbd-kernels-"))
        os.environ["TORCHRBD_CACHE"] = _MADE[0]


def pytest_unconfigure() -> None:
    for folder in _MADE:
        shutil.rmtree(folder, ignore_errors=True)


@pytest.fixture
def fit_alone(request: pytest.FixtureRequest) -> Iterator[None]:
    """Leave out of quick tests what they are not about, see ``shortened.fit_alone``; slow ones run it all."""
    with nullcontext() if request.node.get_closest_marker("slow") else shortened.fit_alone():
        yield


@pytest.fixture
def without_joint_figures() -> Iterator[None]:
    """Leave out of reports what a test does not look at, see ``shortened.without_joint_figures``."""
    with shortened.without_joint_figures():
        yield


@pytest.fixture
def without_simulation() -> Iterator[None]:
    """Leave simulated motion out of results, see ``shortened.without_simulation``."""
    with shortened.without_simulation():
        yield
