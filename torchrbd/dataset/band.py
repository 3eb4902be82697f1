"""The frequency band in which torques are compared."""

from __future__ import annotations

from collections.abc import Sequence

from torchrbd.recordings import LowPass, Survey

# Band as a fraction of the clock's rate, so that the filters fit; upper limit: above it, arms bend rather than move.
_SHARE, _HIGHEST_HZ = 0.12, 30.0


def band_hz(surveys: Sequence[Survey], low_pass: LowPass | None = None) -> float:
    """Return the band [Hz] of a data set: as wide as its slowest clock, and what torques had passed, allow.

    Rows are whitened, and the states hold only what is motion, so frequencies without information cost nothing. A wide
    band is needed for reversals, which identify friction.
    """
    widest = _HIGHEST_HZ if low_pass is None else min(_HIGHEST_HZ, low_pass.end_hz)
    return min(widest, *(_SHARE * s.rate_hz for s in surveys))
