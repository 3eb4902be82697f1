"""The list of estimators at the end of a command's help."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable

from torchrbd.estimators import ESTIMATORS, WITH_INTERVALS

_MARGIN = 15


def list_of(estimators: Iterable[str]) -> str:
    """Return the estimators with what they are, a line or more each."""
    lines = (
        textwrap.fill(f"  {name:<{_MARGIN - 2}}{ESTIMATORS[name]}", 78, subsequent_indent=" " * _MARGIN)
        for name in estimators
    )
    rest = (
        f"Only {', '.join(WITH_INTERVALS)} come with intervals. The others' parameters may be unphysical; the nearest "
        "physical ones are then taken."
    )
    return "\n".join(("Estimators:", *lines, textwrap.fill(rest, 78)))
