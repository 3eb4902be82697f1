"""Proofs by many cases, of which a few are run each time."""

from collections.abc import Collection, Iterable

import pytest


def slow_but(quick: Collection, cases: Iterable) -> list:
    """Return cases for ``pytest.mark.parametrize``, tuples of several arguments or values of one: all slow but some."""
    return [
        pytest.param(*(case if isinstance(case, tuple) else (case,)), marks=() if case in quick else pytest.mark.slow)
        for case in cases
    ]
