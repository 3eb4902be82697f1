"""Below which frequencies a signal is seen that was differentiated more often than its noise allows.

Loads come from accelerations; what differentiates them again makes more of the positions' noise than of the motion, the
faster the more. What is seen below a bandwidth b has less of it; which bandwidth is best the data says. With the
response exp(-(f/b)^2 / 2) what is slower is a little less, too. Where that counts, since b lies within the motion's
band, a Butterworth filter of fourth order, forward and back, leaves what is slower as it is: 1 / (1 + (f/b)^8).
"""

from __future__ import annotations

import math
from collections.abc import Callable

import scipy.fft
import torch
from torch import Tensor

BANDWIDTHS_HZ = (1.5, 3.0, 6.0, 12.0, 48.0)
UNLIMITED_HZ = 1e4
# As far as responses last, in units of 1 / (2 pi b): the standard deviation of a Gaussian one; the slowest pole of a
# Butterworth filter is at sin(pi / 8) of it, so that a millionth is left by then.
_GAUSSIAN_REACH, _BUTTERWORTH_REACH = 8.0, 36.0


def below(x: Tensor, dt: float, hz: float) -> Tensor:
    """Return what of x (..., N) at intervals dt [s] lies below a frequency [Hz], and fades towards it."""
    if hz >= UNLIMITED_HZ:
        return x
    return _filtered(x, dt, lambda f: torch.exp(-0.5 * (f / hz) ** 2), _GAUSSIAN_REACH / (2 * math.pi * hz))


def flat_below(x: Tensor, dt: float, hz: float) -> Tensor:
    """Return the same through a Butterworth filter."""
    if hz >= UNLIMITED_HZ:
        return x
    return _filtered(x, dt, lambda f: 1.0 / (1.0 + (f / hz) ** 8), _BUTTERWORTH_REACH / (2 * math.pi * hz))


def _filtered(x: Tensor, dt: float, response: Callable[[Tensor], Tensor], reach_s: float) -> Tensor:
    """Return x (..., N) through a filter without phase, mirrored through its ends."""
    reach = min(x.shape[-1] - 1, math.ceil(reach_s / dt))
    before = 2 * x[..., :1] - x[..., 1 : reach + 1].flip(-1)
    after = 2 * x[..., -1:] - x[..., x.shape[-1] - 1 - reach : -1].flip(-1)
    longer = torch.cat((before, x, after), -1)
    size = scipy.fft.next_fast_len(longer.shape[-1], real=True)
    f = torch.fft.rfftfreq(size, dt, dtype=x.dtype, device=x.device)
    return torch.fft.irfft(torch.fft.rfft(longer, size) * response(f), size)[..., reach : reach + x.shape[-1]]
