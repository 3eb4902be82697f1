"""Linear recurrences over time as tensors: exact solutions of a first-order state between samples."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn.functional import pad


def recurrence(first: Tensor, decay: Tensor, drive: Tensor) -> Tensor:
    """Return x with x_0 = first and x_k = decay_k x_(k-1) + drive_k, along the last dimension.

    Two steps in a row are one step of the same form, so log2(N) doublings replace N steps.

    Args:
        first: (...).
        decay, drive: (..., N - 1), of the steps.

    Returns:
        (..., N), differentiable.
    """
    # The first sample is a step with decay 0, so values before it do not matter.
    a = torch.cat((torch.zeros_like(first).unsqueeze(-1), decay), -1)
    x = torch.cat((first.unsqueeze(-1), drive), -1)
    step = 1
    while step < x.shape[-1]:
        x = x + a * pad(x[..., :-step], (step, 0))
        a = a * pad(a[..., :-step], (step, 0))
        step *= 2
    return x
