"""Processes that work on cases side by side and end with the program that started them, however that ends."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context, parent_process
from threading import Thread


def workers(count: int, first: Callable[[], None] | None = None) -> ProcessPoolExecutor:
    """Return so many processes; each calls ``first`` before its work."""
    return ProcessPoolExecutor(count, get_context("spawn"), _begin, (first,))


def _begin(first: Callable[[], None] | None) -> None:
    Thread(target=_end_with_parent, daemon=True).start()
    if first is not None:
        first()


def _end_with_parent() -> None:
    parent = parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)
