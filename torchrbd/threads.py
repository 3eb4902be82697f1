"""One thread while small matrices are worked on: more threads wait for each other longer than they compute."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import torch
from threadpoolctl import threadpool_limits


@contextmanager
def single_threaded() -> Iterator[None]:
    """Compute on one thread in torch, BLAS and OpenMP, as a context or a decorator; restore their numbers afterwards.

    The matrices of a robot are so small that a second thread gains nothing, and on busy cores OpenMP's threads spin
    until the others have had their turn.

    Where several threads of a program are inside at once, what is shared by all of them (BLAS) is as the last one met
    it. A program that wants several jobs at once is faster with processes.
    """
    # What torch has must be read before the libraries under it are limited.
    before = torch.get_num_threads()
    with threadpool_limits(1):
        torch.set_num_threads(1)
        try:
            yield
        finally:
            torch.set_num_threads(before)
