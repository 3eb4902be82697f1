"""Early ends of a search: at a time limit, or because the user asks for it.

Work in rounds calls ``is_over`` between them, and ends with its results so far. ``stopped`` then marks the result as
unfinished.
"""

from __future__ import annotations

import math
import re
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from functools import wraps
from typing import Any, ParamSpec, TypeVar

from torchrbd.errors import OptionError

Parameters = ParamSpec("Parameters")
Result = TypeVar("Result")
_SECONDS = {"": 1.0, "s": 1.0, "min": 60.0, "h": 3600.0}
_ASKED = threading.Event()
_LISTENERS: list[Callable[[], None]] = []


@dataclass
class _Limit:
    """A limit [s] on work that began at ``start``; ``stopped`` is set once work was omitted because of it."""

    seconds: float
    start: float
    stopped: bool = False


_LIMIT: ContextVar[_Limit | None] = ContextVar("limit", default=None)


def seconds_of(given: Any) -> float | None:
    """Return a time limit [s]: a number, or text such as '90s', '2min' or '1h'.

    Raises:
        OptionError: it is neither.
    """
    if given is None:
        return None
    found = re.fullmatch(r"\s*([\d.]+(?:[eE][+-]?\d+)?)\s*(s|min|h|)\s*", str(given))
    try:
        seconds = math.nan if found is None else float(found[1]) * _SECONDS[found[2]]
    except ValueError:
        seconds = math.nan
    if not 0.0 < seconds < math.inf:
        raise OptionError(
            f"time_limit is {given!r}; expected seconds above 0, e.g. 90, or text such as '90s' or '2min'"
        )
    return seconds


def time_limited(work: Callable[Parameters, Result]) -> Callable[Parameters, Result]:
    """Apply the argument ``time_limit`` of a function to its work."""

    @wraps(work)
    def limited_work(*args: Parameters.args, **options: Parameters.kwargs) -> Result:
        with limited(seconds_of(options.get("time_limit"))):
            return work(*args, **options)

    return limited_work


@contextmanager
def limited(seconds: float | None) -> Iterator[None]:
    """Limit the work inside the context [s]; None sets no limit, but the user can still ask for an end."""
    token = _LIMIT.set(_Limit(math.inf if seconds is None else seconds, time.monotonic()))
    try:
        yield
    finally:
        _LIMIT.reset(token)


@contextmanager
def asked() -> Iterator[None]:
    """Clear a request to end when the context ends."""
    try:
        yield
    finally:
        _ASKED.clear()


def finish_soon() -> None:
    """Ask the work to end with its results so far; may be called from a signal handler."""
    _ASKED.set()
    for listener in tuple(_LISTENERS):
        listener()


def asked_for() -> bool:
    """Return whether the user has asked for an early end."""
    return _ASKED.is_set()


@contextmanager
def on_request(listener: Callable[[], None]) -> Iterator[None]:
    """Call a function, perhaps in a signal handler, if the user asks for an early end or has already asked."""
    _LISTENERS.append(listener)
    try:
        if asked_for():
            listener()
        yield
    finally:
        _LISTENERS.remove(listener)


def is_over() -> bool:
    """Return whether to omit the remaining work; the caller must omit it if True."""
    limit = _LIMIT.get()
    if limit is None:
        return False
    if _ASKED.is_set() or time.monotonic() - limit.start > limit.seconds:
        limit.stopped = True
    return limit.stopped


def stopped() -> bool:
    """Return whether any work was omitted."""
    limit = _LIMIT.get()
    return limit is not None and limit.stopped


def reached_limit_s() -> float | None:
    """Return the limit [s] at which work ended early; None where the user asked for its end."""
    limit = _LIMIT.get()
    return None if limit is None or _ASKED.is_set() else limit.seconds
