"""Linear recurrences over time as tensors: the exact solution of a first-order state between samples."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn.functional import pad


def recurrence(first: Tensor, decay: Tensor, drive: Tensor) -> Tensor:
    """Return x of x_0 = first, x_k = decay_k x_(k-1) + drive_k along the last dimension.

    Two steps in a row are one step of the same form, so that log2(N) doublings take the place of N steps.

    Args:
        first: (...).
        decay, drive: (..., N - 1), of the steps.

    Returns:
        (..., N), differentiable.
    """
    # The first sample as a step that forgets all before it: nothing needs to be known beyond the ends.
    a = torch.cat((torch.zeros_like(first).unsqueeze(-1), decay), -1)
    x = torch.cat((first.unsqueeze(-1), drive), -1)
    step = 1
    while step < x.shape[-1]:
        x = x + a * pad(x[..., :-step], (step, 0))
        a = a * pad(a[..., :-step], (step, 0))
        step *= 2
    return x
