"""Torques of another sample than the motion: written some rows later or earlier, in all recordings alike.

By how much the clocks of torque and motion are apart is an unknown of every fit (``ordinary.py``), told by what is
fast, so that such a table spoils no parameter. What is not corrected silently is said: whole samples that all
recordings agree on are how a table was written. Other offsets are a filter's, a bus's or the drive's.
"""

from __future__ import annotations

import math
from dataclasses import replace

from torchrbd.inference.preparation import Prepared
from torchrbd.inference.suspicions.results import Suspicion, Suspicions

# Standard deviations within which an offset may lie.
_LIKELY = 3.0
_TESTED = "torques of an earlier or a later sample"


def with_late_torque(suspected: Suspicions, prepared: Prepared) -> Suspicions:
    """Return suspicions with that of torques of another sample, where clocks of torque and motion have been asked."""
    if prepared.late is None:
        return suspected
    found = late_torque(prepared)
    return replace(
        suspected,
        found=(*suspected.found, *([] if found is None else [found])),
        tested=(*suspected.tested, _TESTED),
    )


def late_torque(prepared: Prepared) -> Suspicion | None:
    """Return what the clocks of the recordings that are fitted say, if one whole number of samples suits them all."""
    late, rates = prepared.late or {}, {s.name: s.rate_hz for s in prepared.reading.surveys}
    if not all(name in late for name in prepared.fitted):
        return None
    offsets = [(late[name], rates[name]) for name in prepared.fitted]
    fitting = [_whole((delay - _LIKELY * std) * rate, (delay + _LIKELY * std) * rate) for (delay, std), rate in offsets]
    number, *others = set.intersection(*fitting) or {0}
    if number == 0 or others:
        return None
    weights = [std**-2.0 for (_, std), _ in offsets]
    mean = sum(w * delay for w, ((delay, _), _) in zip(weights, offsets, strict=True)) / sum(weights)
    delay = prepared.recordings[0].torque_delay_s + number / offsets[0][1]
    count, way = f"{abs(number)} sample{'s' * (abs(number) > 1)}", "later" if number > 0 else "earlier"
    return Suspicion(
        "late torque",
        (),
        sum(0.5 * (delay / std) ** 2 for (delay, std), _ in offsets),
        math.nan,
        f"the torques are {count} {way} than the motion "
        f"({1e3 * abs(mean):.3g} ± {1.96e3 * sum(weights) ** -0.5:.2g} ms)",
        f"fits allow for it; if the table was written so, give --mapping a file with '{{torque_delay: {delay:.4g}}}'",
        settles=False,
        spoils=False,
    )


def _whole(low: float, high: float) -> set[int]:
    return set(range(math.ceil(low), math.floor(high) + 1))
