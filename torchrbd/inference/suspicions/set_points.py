"""Set-points that no drive follows: in degrees, of the opposite sign, or those of another joint.

A joint j follows a set-point r up to its tracking error, e = mean (q_j - r)^2. As elsewhere, a writing of the table has
to beat what it says, and a joint that rests at its mean:

    log odds = sum_j N/2 log(min(mean (q_j - r_j)^2, var q_j) / mean (q_j - r'_j)^2)
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from itertools import combinations
from typing import Any

import numpy as np

from torchrbd.inference.preparation import Prepared
from torchrbd.inference.suspicions.correcting import entry_of, generalise_entries, source_of
from torchrbd.inference.suspicions.results import Meaning, Suspicion
from torchrbd.recordings import Recording

_DEGREE, _SWAPPED = math.pi / 180.0, "swapped set-points"


@dataclass(frozen=True)
class _Moments:
    """Mean products over the rows of all recordings: q q' of each joint, (n,); q_j r_k and r_k r_k; var q."""

    q: np.ndarray
    cross: np.ndarray
    r: np.ndarray
    var: np.ndarray

    def error(self, j: int, k: int, scale: float = 1.0) -> float:
        """Return the mean square of q_j - scale r_k [rad^2, m^2]."""
        return max(self.q[j] - 2.0 * scale * self.cross[j, k] + scale**2 * self.r[k], np.finfo(float).tiny)

    def gain(self, j: int, k: int, scale: float = 1.0) -> float:
        """Return the factor by which the error of joint j falls with another set-point, against a constant too."""
        return min(self.error(j, j), self.var[j]) / self.error(j, k, scale)


def set_point_suspicions(prepared: Prepared, nats: float, bound: float) -> list[Suspicion]:
    """Return what set-points seem to mean instead of what they say.

    Args:
        prepared: the data.
        nats: what a squared error that falls to 1 / e is worth at one joint, N/2.
        bound: log odds from which on something is suspected.
    """
    recordings = [r for r in prepared.recordings if r.name in prepared.fitted and r.drives.of]
    if not recordings:
        return []
    driven = recordings[0].drives.index
    moments = _moments(recordings)
    names, found = prepared.robot.joint_names, list[Suspicion]()
    for kind, joints, log_gain, entries in _writings(moments, driven, prepared):
        if nats * log_gain > bound:
            every = len(joints) == len(driven) > 1 and kind != _SWAPPED
            where = () if every else tuple(names[j] for j in joints)
            mapping = {"joints": generalise_entries({name: {"q_ref": one} for name, one in entries.items()}, prepared)}
            times = math.exp(log_gain / len(joints))
            found.append(Suspicion(kind, where, nats * log_gain, times, Meaning(kind, where), mapping=mapping))
    return sorted(found, key=lambda one: -one.log_odds)[:1]


def _writings(
    moments: _Moments, driven: list[int], prepared: Prepared
) -> Iterator[tuple[str, list[int], float, dict[str, Any]]]:
    """Yield kind, joints, the sum of the logarithms of their gains, and the mapping's entries of their set-points."""
    names = prepared.robot.joint_names
    source = {names[j]: source_of(prepared, "q_ref", names[j]) for j in driven}
    for kind, scale, entry in (
        ("set-points in degrees", _DEGREE, partial(entry_of, unit="deg")),
        ("set-points of the opposite sign", -1.0, partial(entry_of, turned=True)),
    ):
        logs = {j: math.log(moments.gain(j, j, scale)) for j in driven}
        joints = [j for j, one in logs.items() if one > 0.0]
        entries = {names[j]: entry(source[names[j]]) for j in joints}
        if joints:
            yield kind, joints, sum(logs[j] for j in joints), entries
    for j, k in combinations(driven, 2):
        log_gain = math.log(moments.gain(j, k)) + math.log(moments.gain(k, j))
        yield _SWAPPED, [j, k], log_gain, {names[j]: entry_of(source[names[k]]), names[k]: entry_of(source[names[j]])}


def _moments(recordings: list[Recording]) -> _Moments:
    """Stream recordings; rows in which a driven joint has no position or set-point are left out."""
    at, n = recordings[0].drives.index, len(recordings[0].joints)
    count, total, q2, r2, cross = 0, np.zeros(n), np.zeros(n), np.zeros(n), np.zeros((n, n))
    for recording in recordings:
        for chunk in recording.chunks():
            assert chunk.q_ref is not None
            rows = np.isfinite(chunk.q[:, at]).all(1) & np.isfinite(chunk.q_ref[:, at]).all(1)
            q, r = np.nan_to_num(chunk.q[rows]), np.nan_to_num(chunk.q_ref[rows])
            count += len(q)
            total, q2, r2 = total + q.sum(0), q2 + (q**2).sum(0), r2 + (r**2).sum(0)
            cross += q.T @ r
    count = max(count, 1)
    return _Moments(q2 / count, cross / count, r2 / count, np.maximum(q2 / count - (total / count) ** 2, 0.0))
