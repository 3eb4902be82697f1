"""Proofs by many cases, of which a few are run each time, and fits without what a test is not about."""

from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager
from importlib import import_module

import pytest


def slow_but(quick: Collection, cases: Iterable) -> list:
    """Return cases for ``pytest.mark.parametrize``, tuples of several arguments or values of one: all slow but some."""
    return [
        pytest.param(*(case if isinstance(case, tuple) else (case,)), marks=() if case in quick else pytest.mark.slow)
        for case in cases
    ]


@contextmanager
def fit_alone() -> Iterator[None]:
    """Let ``identify`` and ``diagnose`` neither search for wrong units and columns nor simulate motion.

    Both take more than half of a short identification's time and change neither parameters nor torque errors.
    """
    from torchrbd.inference.suspicions import NO_SUSPICIONS

    with pytest.MonkeyPatch.context() as patch, without_simulation():
        for name in ("inference.identify", "diagnosis.diagnose"):
            patch.setattr(import_module(f"torchrbd.{name}"), "suspicions", lambda *_: NO_SUSPICIONS)
        yield


@contextmanager
def without_simulation() -> Iterator[None]:
    """Let ``identify`` and ``diagnose`` not simulate motion."""
    from torchrbd.simulation import MotionErrors

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(import_module("torchrbd.inference.identify"), "motion_errors", lambda *_: MotionErrors((), ()))
        yield


@contextmanager
def without_joint_figures() -> Iterator[None]:
    """Let a report leave out the figures of each joint, which take most of the time that a page takes."""
    from markupsafe import Markup

    from torchrbd.report.page import JointFigures, Page

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Page, "figures", lambda *_: JointFigures(Markup(), "", False, []))
        yield
