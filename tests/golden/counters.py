"""What a diagnosis costs, in counts that do not depend on the machine: passes, statistics, fits, factorisations."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from importlib import import_module
from typing import Any
from unittest.mock import patch

# Each is counted when it is called. A step that renames one of them renames it here.
COUNTED = {
    "recordings_read": "torchrbd.dataset.reading:Reading.tiles",
    "statistics": "torchrbd.dataset.reading:Reading.statistics",
    "likelihoods": "torchrbd.likelihood.likelihood:Likelihood.__init__",
    "factorisations": "torchrbd.likelihood.root:Root.__init__",
    "solves": "torchrbd.likelihood.physical_fit:follow_path",
}


@contextmanager
def counters() -> Iterator[dict[str, float]]:
    """Count what is called inside; processor seconds are for information."""
    found: dict[str, float] = dict.fromkeys(COUNTED, 0)
    patches = [_counting(found, name, *place.split(":")) for name, place in COUNTED.items()]
    start = time.process_time()
    for one in patches:
        one.start()
    try:
        yield found
    finally:
        for one in patches:
            one.stop()
        found["cpu_s"] = round(time.process_time() - start, 2)


def _counting(found: dict[str, float], name: str, module: str, attribute: str) -> Any:
    *owners, last = attribute.split(".")
    owner: Any = import_module(module)
    for each in owners:
        owner = getattr(owner, each)
    function: Callable[..., Any] = getattr(owner, last)

    @wraps(function)
    def counted(*args: Any, **options: Any) -> Any:
        found[name] += 1
        return function(*args, **options)

    return patch.object(owner, last, counted)
