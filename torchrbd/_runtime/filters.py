"""Finite filters along the last axis; compiled where possible, with the same results to rounding."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import scipy.fft
import torch
from scipy.signal import lfilter
from torch import Tensor

from torchrbd._runtime.compiling import ADDRESS, INTEGER, Source, is_plain, library

COMPILED = Source(
    Path(__file__).parent,
    ("filters.c",),
    {"thinned": (*[INTEGER] * 5, *[ADDRESS] * 3), "unpredicted": (*[INTEGER] * 4, *[ADDRESS] * 4)},
)
# Rows per matrix product; it needs a copy of the samples for each tap of the filter.
_ROWS_AT_ONCE = 32


def thinned(x: Tensor, kernel: Tensor, stride: int, outputs: int) -> Tensor:
    """Return weighted sums of the samples from each ``stride``-th sample on, (..., outputs). Differentiable.

    Args:
        x: (..., N).
        kernel: (taps,) weights of a sample and those after it.
        stride: samples from one sum to the next.
        outputs: number of sums.
    """
    taps, rows = kernel.shape[0], x.reshape(-1, x.shape[-1])
    if is_plain(x) and (compiled := library(COMPILED)) is not None:
        rows, kernel = rows.contiguous(), kernel.to(x)
        found = x.new_empty(len(rows), outputs)
        addresses = kernel.data_ptr(), rows.data_ptr(), found.data_ptr()
        compiled.thinned(*rows.shape, taps, stride, outputs, *addresses)
    else:
        kernel = kernel.to(x)
        parts = [some.unfold(-1, taps, stride)[:, :outputs] @ kernel for some in rows.split(_ROWS_AT_ONCE)]
        found = torch.cat(parts)
    return found.reshape(*x.shape[:-1], outputs)


def convolved(x: Tensor, kernels: Tensor) -> Tensor:
    """Convolve x (n, N) with each of its kernels (n, k, taps) where they overlap fully: (k, n, N - taps + 1).

    Args:
        x: rows of samples.
        kernels: (n, k, taps), or (1, k, taps) for all rows.
    """
    samples, taps = x.shape[1], kernels.shape[2]
    size = int(scipy.fft.next_fast_len(samples, real=True) or samples)
    spectrum = torch.fft.rfft(x, size) * torch.fft.rfft(kernels, size).transpose(0, 1)
    return torch.fft.irfft(spectrum, size)[..., taps - 1 : samples]


def unpredicted(x: np.ndarray, predictor: np.ndarray, index: np.ndarray) -> np.ndarray:
    """Return the errors of a linear predictor at some samples, (..., m): x_k - sum_i a_i x_(k-i).

    Args:
        x: (..., N), zero before the first sample.
        predictor: a (p,), weights of the p samples before.
        index: (m,) samples.

    Raises:
        MemoryError: there is not enough memory.
    """
    compiled = library(COMPILED)
    if compiled is None:
        return np.asarray(lfilter(np.concatenate(([1.0], -predictor)), 1.0, x))[..., index]
    x, a, index = (np.ascontiguousarray(v, dtype=d) for v, d in ((x, float), (predictor, float), (index, np.int64)))
    found = np.empty((*x.shape[:-1], len(index)))
    sizes = x.size // x.shape[-1], x.shape[-1], len(a), len(index)
    if compiled.unpredicted(*sizes, *(v.ctypes.data for v in (a, index, x, found))):
        raise MemoryError("no memory to whiten rows")
    return found
