"""Low-pass filters for signals that are differentiated more often than their noise allows.

Rigid-body torques come from accelerations. Each further derivative amplifies the noise of the positions, most of all at
high frequencies. A low-pass filter of bandwidth b removes much of it; the data choose b. The Gaussian response
exp(-(f/b)^2 / 2) also weakens slower motion a little. Where that matters, since b lies within the motion's band, use
the Butterworth filter of fourth order, forward and back. Its response 1 / (1 + (f/b)^8) is flat below b.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import scipy.fft
import torch
from torch import Tensor

BANDWIDTHS_HZ = (1.5, 3.0, 6.0, 12.0, 48.0)
UNLIMITED_HZ = 1e4
# Length of the impulse responses in units of 1 / (2 pi b), the standard deviation of the Gaussian one. The slowest pole
# of the Butterworth filter is at sin(pi / 8) of 2 pi b: its response has decayed to a millionth by then.
_GAUSSIAN_REACH, _BUTTERWORTH_REACH = 8.0, 36.0


def below(x: Tensor, dt: float, hz: float) -> Tensor:
    """Return x (..., N), sampled at intervals dt [s], through a Gaussian low-pass filter of bandwidth hz [Hz]."""
    if hz >= UNLIMITED_HZ:
        return x
    return _filtered(x, dt, lambda f: torch.exp(-0.5 * (f / hz) ** 2), _GAUSSIAN_REACH / (2 * math.pi * hz))


def flat_below(x: Tensor, dt: float, hz: float) -> Tensor:
    """Return x (..., N), sampled at intervals dt [s], through a Butterworth low-pass filter of bandwidth hz [Hz]."""
    if hz >= UNLIMITED_HZ:
        return x
    return _filtered(x, dt, lambda f: 1.0 / (1.0 + (f / hz) ** 8), _BUTTERWORTH_REACH / (2 * math.pi * hz))


def _filtered(x: Tensor, dt: float, response: Callable[[Tensor], Tensor], reach_s: float) -> Tensor:
    """Return x (..., N) through a zero-phase filter; the ends are continued by reflection."""
    reach = min(x.shape[-1] - 1, math.ceil(reach_s / dt))
    before = 2 * x[..., :1] - x[..., 1 : reach + 1].flip(-1)
    after = 2 * x[..., -1:] - x[..., x.shape[-1] - 1 - reach : -1].flip(-1)
    longer = torch.cat((before, x, after), -1)
    size = scipy.fft.next_fast_len(longer.shape[-1], real=True)
    f = torch.fft.rfftfreq(size, dt, dtype=x.dtype, device=x.device)
    return torch.fft.irfft(torch.fft.rfft(longer, size) * response(f), size)[..., reach : reach + x.shape[-1]]
