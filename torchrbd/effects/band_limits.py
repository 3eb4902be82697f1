"""Below which frequencies a signal is seen that was differentiated more often than its noise allows.

Loads come from accelerations; what differentiates them again makes more of the positions' noise than of the motion, the
faster the more. What is seen below a bandwidth b, with the response exp(-(f/b)^2 / 2), has less of it; which bandwidth
is best the data says.
"""

from __future__ import annotations

import math

import scipy.fft
import torch
from torch import Tensor

BANDWIDTHS_HZ = (1.5, 3.0, 6.0, 12.0, 48.0)
UNLIMITED_HZ = 1e4
# As far as the response lasts, in its standard deviations 1 / (2 pi b).
_REACH = 8.0


def below(x: Tensor, dt: float, hz: float) -> Tensor:
    """Return what of x (..., N) at intervals dt [s] lies below a frequency [Hz]; mirrored through its ends."""
    if hz >= UNLIMITED_HZ:
        return x
    reach = min(x.shape[-1] - 1, math.ceil(_REACH / (2 * math.pi * hz * dt)))
    before = 2 * x[..., :1] - x[..., 1 : reach + 1].flip(-1)
    after = 2 * x[..., -1:] - x[..., x.shape[-1] - 1 - reach : -1].flip(-1)
    longer = torch.cat((before, x, after), -1)
    size = scipy.fft.next_fast_len(longer.shape[-1], real=True)
    f = torch.fft.rfftfreq(size, dt, dtype=x.dtype, device=x.device)
    spectrum = torch.fft.rfft(longer, size) * torch.exp(-0.5 * (f / hz) ** 2)
    return torch.fft.irfft(spectrum, size)[..., reach : reach + x.shape[-1]]
