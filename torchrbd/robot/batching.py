"""Conversion between batches with the samples first, as users have them, and tiles with the samples last, for speed."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

TILE, TILE_ELSEWHERE = 2048, 1 << 18
"""Samples per tile on the CPU and on other devices.

Intermediate results then stay in the cache, or keep a GPU busy, and memory beyond the result is bounded.
"""


def batch_last(*inputs: Tensor) -> tuple[tuple[Tensor, ...], torch.Size]:
    """Return (*batch, n) tensors, whose batches broadcast, as (n, N), and the batch shape."""
    inputs = torch.broadcast_tensors(*inputs)
    return tuple(x.reshape(-1, x.shape[-1]).T.contiguous() for x in inputs), inputs[0].shape[:-1]


def batch_first(x: Tensor, batch: torch.Size) -> Tensor:
    """Return a (..., N) tensor as a (*batch, ...) view."""
    return x.movedim(-1, 0).unflatten(0, batch) if batch else x[..., 0]


def tiles(*inputs: Tensor) -> list[tuple[Tensor, ...]]:
    """Return (..., N) tensors as views of at most one tile of samples each."""
    size = TILE if inputs[0].is_cpu else TILE_ELSEWHERE
    return list(zip(*(x.split(size, -1) for x in inputs), strict=True))


def tiled(function: Callable[..., Tensor], *inputs: Tensor) -> Tensor:
    """Return a function of (..., N) tensors, computed tile by tile; in one piece where a graph is traced for any N."""
    if torch.compiler.is_compiling():
        return function(*inputs)
    parts = [function(*tile) for tile in tiles(*inputs)]
    return parts[0] if len(parts) == 1 else torch.cat(parts, -1)


def zeros(like: Tensor, *shape: int) -> Tensor:
    """Return zeros in the dtype and on the device of `like`."""
    numpy_dtype = {torch.float32: np.float32, torch.float64: np.float64}.get(like.dtype)
    if like.device.type != "cpu" or numpy_dtype is None:
        return like.new_zeros(shape)
    # numpy gets huge zeroed pages from the system: zeros that are never written cost no time and no memory.
    return torch.from_numpy(np.zeros(shape, numpy_dtype))


def is_ordinary(x: Tensor) -> bool:
    """Return whether a tensor may be cached: not one of a tracer (meaningless later), nor of inference mode."""
    return not torch.compiler.is_compiling() and type(x) is Tensor and not x.is_inference()
