"""Ctrl-C while a search runs: the first ends it with what was found, the second ends the program."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import FrameType

from torchrbd._runtime.deadline import asked, finish_soon

_WORDS = b"\ntorchrbd: finishing with what was found; press Ctrl-C again to stop at once\n"
_SIGNALS = (signal.SIGINT, signal.SIGTERM)


@contextmanager
def finishing_on_interrupt() -> Iterator[None]:
    """Let the first SIGINT or SIGTERM end a search with what it has found; the second raises KeyboardInterrupt."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def first(*_: object) -> None:
        finish_soon()
        for kind in _SIGNALS:
            signal.signal(kind, _second)
        # Not through a stream, which may be in the middle of a line of its own.
        with suppress(OSError):
            os.write(2, _WORDS)

    before = {kind: signal.signal(kind, first) for kind in _SIGNALS}
    try:
        with asked():
            yield
    finally:
        for kind, handler in before.items():
            signal.signal(kind, handler)


def _second(_: int, __: FrameType | None) -> None:
    raise KeyboardInterrupt
