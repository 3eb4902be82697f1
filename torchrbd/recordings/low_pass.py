"""The low-pass that torques passed before they were recorded: a Butterworth filter, run forwards and backwards.

    H(f) = 1 / (1 + (f / f_half)^(2 n))

People filter torques before they store them, often with the positions. What such a recording lacks above f_half the
robot did not lack: dry friction changes its sign at once, but a recording of 2 Hz shows it over tenths of a second.
A model whose torque does not pass the same filter fits neither the reversals nor, with them, its inertia.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

# The kernel ends where its envelope is below this part of its largest value; samples of its spectrum per sample of it.
_LEAST, _OVERSAMPLED = 1e-2, 8


@dataclass(frozen=True)
class LowPass:
    """A filter without phase.

    Attributes:
        half_hz: frequency of half amplitude [Hz].
        order: n, of the filter that was run twice.
        end_hz: frequency above which it leaves nothing but rounding [Hz].
    """

    half_hz: float
    order: int
    end_hz: float = math.inf

    @property
    def reach_s(self) -> float:
        """Time after which a pulse has died away, by the slowest pole [s]."""
        decay = 2.0 * math.pi * self.half_hz * math.sin(0.5 * math.pi / self.order)
        return -math.log(_LEAST) / decay

    def kernel(self, dt: float) -> np.ndarray:
        """Return the symmetric weights (2 R + 1,) at a sampling interval dt [s], of gain one for a constant."""
        return _kernel(self, dt)


@lru_cache(maxsize=64)
def _kernel(low_pass: LowPass, dt: float) -> np.ndarray:
    half = max(1, math.ceil(low_pass.reach_s / dt))
    f = np.fft.rfftfreq(2 * _OVERSAMPLED * half, dt)
    right = np.fft.irfft(1.0 / (1.0 + (f / low_pass.half_hz) ** (2 * low_pass.order)))[: half + 1]
    kernel = np.concatenate((right[:0:-1], right))
    return kernel / kernel.sum()
