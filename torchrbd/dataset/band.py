"""The frequency band in which torques are compared."""

from __future__ import annotations

from collections.abc import Sequence

from torchrbd.recordings import Survey

# Band as a fraction of the clock's rate, so that the filters fit; upper limit: above it, arms bend rather than move.
_SHARE, _HIGHEST_HZ = 0.12, 30.0


def band_hz(surveys: Sequence[Survey]) -> float:
    """Return the band [Hz] of a data set: as wide as its slowest clock allows.

    Rows are whitened, and the states hold only what is motion, so frequencies without information cost nothing. A wide
    band is needed for reversals, which identify friction.
    """
    return min(_HIGHEST_HZ, *(_SHARE * s.rate_hz for s in surveys))
