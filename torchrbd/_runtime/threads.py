"""One thread for small matrices: with more, threads spend longer waiting for each other than computing."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import torch
from threadpoolctl import threadpool_limits


@contextmanager
def single_threaded() -> Iterator[None]:
    """Compute on one thread in torch, BLAS and OpenMP, as a context or a decorator; restore their settings afterwards.

    A robot's matrices are so small that a second thread gains nothing. On busy cores OpenMP's threads even spin until
    the others have had their turn.

    If several threads of a program are inside at once, the shared setting (BLAS) is the one that the last found. For
    several jobs at once, processes are faster.
    """
    # Read torch's setting before the libraries below it are limited.
    before = torch.get_num_threads()
    with threadpool_limits(1):
        torch.set_num_threads(1)
        try:
            yield
        finally:
            torch.set_num_threads(before)
