"""Up to which frequency rows are compared."""

from __future__ import annotations

from collections.abc import Sequence

from torchrbd.recordings import Survey

# Of the clock's rate, so that its filters have room; above, arms hardly move and bend instead.
_SHARE, _HIGHEST_HZ = 0.12, 30.0


def band_hz(surveys: Sequence[Survey]) -> float:
    """Return the band [Hz] of a data set: as wide as its slowest clock allows.

    Rows are whitened and the states hold no more than is motion, so that frequencies that tell nothing cost nothing;
    reversals of friction, which tell it from everything else, need a wide band.
    """
    return min(_HIGHEST_HZ, *(_SHARE * s.rate_hz for s in surveys))
