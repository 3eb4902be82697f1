"""Kernels are built once for all processes of a session; long tests come first; what quick tests may leave out."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import nullcontext

import pytest
import shortened

_MADE: list[str] = []
# Of the tests that take longest; what comes last is short, so that no core waits for another.
_FIRST = (
    "test_cli.py", "test_docs_code.py", "test_real_recordings.py", "test_invariance.py", "test_suspect.py",
    "test_dead_zone.py", "test_verdicts.py", "test_smoothing_hard_input.py", "test_resting_joints.py",
    "test_coupled_motor.py", "test_tilted_base.py", "test_time_limit.py",
)  # fmt: skip


def pytest_configure(config: pytest.Config) -> None:
    # Workers of pytest-xdist inherit what the session that started them has set.
    if not hasattr(config, "workerinput"):
        _MADE.append(tempfile.mkdtemp(prefix="torchrbd-kernels-"))
        os.environ["TORCHRBD_CACHE"] = _MADE[0]


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    place = {name: k for k, name in enumerate(_FIRST)}
    items.sort(key=lambda item: place.get(item.path.name, len(place)))


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
