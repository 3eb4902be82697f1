"""Torques of another sample than the motion: written some rows later or earlier, in all recordings alike.

Every fit has an unknown clock offset between torque and motion (``ordinary.py``), so that such a table biases no
parameter. The correction is reported, not silent: whole samples that all recordings agree on are how a table was
written. Other offsets are a filter's, a bus's or the drive's.
"""

from __future__ import annotations

import math
from dataclasses import replace

from torchrbd.inference.preparation import Prepared
from torchrbd.inference.suspicions.results import Meaning, Suspicion, Suspicions

# Standard deviations within which an offset may lie.
_LIKELY = 3.0
_TESTED = "late torque"


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
    return Suspicion(
        "late torque",
        (),
        sum(0.5 * (delay / std) ** 2 for (delay, std), _ in offsets),
        math.nan,
        Meaning("late torque"),
        sizes={"samples": float(number), "delay_s": mean, "delay_std_s": sum(weights) ** -0.5},
        mapping={"torque_delay": float(f"{delay:.4g}")},
        settles=False,
        spoils=False,
    )


def _whole(low: float, high: float) -> set[int]:
    return set(range(math.ceil(low), math.floor(high) + 1))
