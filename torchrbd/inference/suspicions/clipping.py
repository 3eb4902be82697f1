"""Torques that are cut off: the reading ends at a limit, and the motion asks for more.

An actuator that gives no more than its limit leaves the reading right: then the torque that a model predicts there,
fitted to all other time, is the limit too. Where it lies beyond by d on average, against errors s elsewhere,

    log odds = N/2 log(d^2 / s^2)

with N the times that the limit is reached, so far apart that the filter has forgotten, and 8 at most.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from torchrbd.inference.preparation import Prepared
from torchrbd.inference.suspicions.results import Meaning, Suspicion
from torchrbd.inference.suspicions.samples import Samples
from torchrbd.inference.suspicions.writing import Writing
from torchrbd.recordings.channels import channels_of

_MOST_TIMES = 8
# A sample is of the limit if so much of what the filter sees is; of no limit, if there is none in three times that.
_OF_LIMIT, _AWAY = 0.25, 3.0


@dataclass(frozen=True)
class _Limit:
    """One end of a torque's range, reached again and again.

    Attributes:
        joint: its index.
        value: of the torque [N m, N].
        up: whether it is the largest.
        column: of the torque.
        rows: by number of the recording, times (R,) of the rows that are there [s].
        share: of all rows.
    """

    joint: int
    value: float
    up: bool
    column: str
    rows: dict[int, np.ndarray]
    share: float


def clipped_torques(prepared: Prepared, samples: Samples, now: Writing, bound: float) -> Iterator[Suspicion]:
    """Yield a suspicion for each torque that is cut off.

    Args:
        prepared: the data.
        samples: of the table.
        now: how it is read, as it stands.
        bound: log odds from which on something is suspected.
    """
    limits = [one for one in _limits(prepared) if bool(samples.judged[one.joint])]
    if not limits:
        return
    shares = [_shares(one, prepared, samples) for one in limits]
    without = torch.zeros_like(samples.tau, dtype=torch.bool)
    for one, (_, near) in zip(limits, shares, strict=True):
        without[one.joint] |= near
    predicted = samples.predicted(now, without)
    for one, (at, _) in zip(limits, shares, strict=True):
        error = (samples.tau - predicted)[one.joint]
        beyond, free = error[at] * (-1.0 if one.up else 1.0), error[~without[one.joint]]
        if not len(beyond) or len(free) < 2 or not beyond.mean() > 0:
            continue
        times = int((torch.diff(at.int(), prepend=at.new_zeros(1).int()) > 0).sum())
        odds = 0.5 * min(times, _MOST_TIMES) * math.log(float(beyond.mean() ** 2 / free.square().mean()))
        if odds > bound:
            yield _suspicion(one, odds, float(beyond.mean()), prepared)


def _limits(prepared: Prepared) -> Iterator[_Limit]:
    """Yield the limits at which torques stay, of all recordings together."""
    found: dict[tuple[int, float], dict[int, np.ndarray]] = {}
    for k, (recording, seen) in enumerate(zip(prepared.recordings, prepared.reading.surveys, strict=True)):
        for one in channels_of(recording, {"tau": seen.tau_resolution}):
            j = recording.joints.index(one.joint)
            for value, cut in ((one.low, one.clipped_low), (one.high, one.clipped_high)):
                if one.signal == "tau" and cut:
                    rows = [c.t[np.isclose(c.tau[:, j], value, rtol=1e-9)] for c in recording.chunks()]
                    found.setdefault((j, value), {})[k] = np.concatenate(rows)
    total = sum(seen.rows for seen in prepared.reading.surveys)
    for (j, value), rows in found.items():
        source = prepared.recordings[next(iter(rows))].source("tau", prepared.robot.joint_names[j])
        assert source is not None
        yield _Limit(j, value, value > 0, source.column, rows, sum(map(len, rows.values())) / total)


def _shares(limit: _Limit, prepared: Prepared, samples: Samples) -> tuple[Tensor, Tensor]:
    """Return which samples (M,) are of a limit, and which are near one."""
    half = 0.5 / prepared.filtering.cutoff_hz
    at, near = torch.zeros(2, len(samples.t), dtype=torch.bool)
    for k, rows in limit.rows.items():
        own = samples.recording == k
        t = samples.t[own].numpy()
        within = [np.searchsorted(rows, t + w) - np.searchsorted(rows, t - w) for w in (half, _AWAY * half)]
        at[own] = torch.from_numpy(within[0] > _OF_LIMIT * 2.0 * half * prepared.reading.surveys[k].rate_hz)
        near[own] = torch.from_numpy(within[1] > 0)
    return at, near


def _suspicion(limit: _Limit, odds: float, beyond: float, prepared: Prepared) -> Suspicion:
    joint = prepared.robot.joint_names[limit.joint]
    unit = "N" if bool(prepared.robot.prismatic[limit.joint]) else "N m"
    effort = float(prepared.robot.effort[limit.joint])
    known = math.isclose(abs(limit.value), effort, rel_tol=1e-3)
    return Suspicion(
        "clipped torque",
        (joint,),
        odds,
        math.nan,
        Meaning("clipped torque", (joint,), unit),
        sizes={"limit": limit.value, "share": limit.share, "beyond": beyond, "is_effort_limit": float(known)},
        names={"column": limit.column},
        settles=False,
    )
