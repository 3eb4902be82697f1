"""Position drives: the torque that a drive makes of its set-point, for robots that record no torque."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from torchrbd.recordings.chunk import Chunk

_TURN = 2 * math.pi
# A jump that differs from whole turns by less [rad] is one of a continuous joint's angle.
_TURN_TOLERANCE = 0.2


@dataclass(frozen=True)
class Drive:
    """A drive with a proportional-derivative law: tau = clip(kp (q_ref - q) - kd qd, -limit, limit).

    Attributes:
        kp: stiffness [N m/rad, N/m].
        kd: damping [N m s/rad, N s/m].
        limit: greatest torque or force of either sign [N m, N]; infinity without a limit.

    NaN as stiffness is one that is to be estimated.
    """

    kp: float
    kd: float = 0.0
    limit: float = math.inf

    @property
    def is_known(self) -> bool:
        """Whether its stiffness is known."""
        return not math.isnan(self.kp)

    def torque(self, error: np.ndarray, qd: np.ndarray) -> np.ndarray:
        """Return the torque [N m, N] for position errors q_ref - q and velocities of one shape [rad, m, per s]."""
        return np.clip(self.kp * error - self.kd * qd, -self.limit, self.limit)


@dataclass(frozen=True)
class Gain:
    """An estimated factor between what is recorded of a joint and its torque.

    Attributes:
        joint: its joint.
        kind: "kp", the stiffness of a drive [N m/rad, N/m], or "torque_constant" of a motor [N m/A, N/A].
        value: median.
        low, high: 95 % interval.
    """

    joint: str
    kind: str
    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Drives:
    """The drives of a robot's joints, which follow their set-points with one delay.

        tau(t) = clip(kp (q_ref(t - delay) - q(t)) - kd qd(t), -limit, limit)

    Set-points are interpolated linearly. A velocity that was not recorded is (q[k+1] - q[k-1]) / (t[k+1] - t[k-1]), so
    that it is not late. Whole turns by which the angles of set-point and joint jump are removed.

    Attributes:
        joints: the robot's, in the order of a recording's columns.
        of: by joint, for those that have a drive.
        delay_s: time after which drives follow a recorded set-point [s]; below zero where it was recorded late.
    """

    joints: tuple[str, ...]
    of: Mapping[str, Drive]
    delay_s: float = 0.0

    def to_content(self) -> dict[str, Any]:
        """Return what ``from_content`` reads, for JSON; no limit is null."""
        limits = {joint: drive.limit if math.isfinite(drive.limit) else None for joint, drive in self.of.items()}
        of = {joint: {"kp": one.kp, "kd": one.kd, "limit": limits[joint]} for joint, one in self.of.items()}
        return {"joints": list(self.joints), "of": of, "delay_s": self.delay_s}

    @classmethod
    def from_content(cls, content: Mapping[str, Any]) -> Drives:
        """Return drives from the result of ``to_content``."""
        of = {
            joint: Drive(float(one["kp"]), float(one["kd"]), math.inf if one["limit"] is None else float(one["limit"]))
            for joint, one in content["of"].items()
        }
        return cls(tuple(map(str, content["joints"])), of, float(content["delay_s"]))

    @property
    def index(self) -> list[int]:
        """Indices of the joints that have a drive, in the order of ``of``."""
        return [self.joints.index(joint) for joint in self.of]

    @property
    def stiffness(self) -> np.ndarray:
        """kp (n,), zero for joints without a drive."""
        return np.array([self.of[joint].kp if joint in self.of else 0.0 for joint in self.joints])

    @property
    def damping(self) -> np.ndarray:
        """kd (n,), zero for joints without a drive."""
        return np.array([self.of[joint].kd if joint in self.of else 0.0 for joint in self.joints])

    @property
    def limits(self) -> np.ndarray:
        """Greatest torque (n,), infinite for joints without a drive or a limit."""
        return np.array([self.of[joint].limit if joint in self.of else math.inf for joint in self.joints])

    @property
    def unknown(self) -> list[str]:
        """Joints whose stiffness is to be estimated."""
        return [joint for joint, drive in self.of.items() if not drive.is_known]

    def with_stiffness(self, kp: Mapping[str, float]) -> Drives:
        """Return the same drives with the stiffness of some joints."""
        return replace(self, of={j: replace(d, kp=kp[j]) if j in kp else d for j, d in self.of.items()})

    def with_unit_stiffness(self) -> Drives:
        """Return drives whose torque is the position error, where the stiffness is to be estimated."""
        return replace(self, of={j: d if d.is_known else Drive(1.0) for j, d in self.of.items()})

    def of_joints(self, joints: Sequence[str]) -> Drives:
        """Return the same drives for another order of the joints."""
        return replace(self, joints=tuple(joints))

    def with_torque(self, chunks: Iterable[Chunk]) -> Iterator[Chunk]:
        """Yield consecutive chunks, which have set-points, with the drives' torques, and set-points when they act."""
        turns, last = np.zeros(len(self.of)), np.full(len(self.of), np.nan)
        for before, chunk, after in _in_context(chunks, abs(self.delay_s)):
            error = self._errors(before, chunk, after)
            error, turns, last = _without_turns(error, turns, last)
            yield self._driven(chunk, error, _velocity(before[-1:], chunk, after[:1]))

    def _errors(self, before: Sequence[Chunk], chunk: Chunk, after: Sequence[Chunk]) -> np.ndarray:
        """Return q_ref(t - delay) - q(t) of the joints with a drive, (N, d)."""
        assert chunk.q_ref is not None
        q = chunk.q[:, self.index]
        if not self.delay_s:
            return chunk.q_ref[:, self.index] - q
        parts = (*before, chunk, *after)
        t = np.concatenate([one.t for one in parts])
        found = np.full(q.shape, np.nan)
        for column, k in enumerate(self.index):
            wanted = np.concatenate([one.q_ref[:, k] for one in parts if one.q_ref is not None])
            known = np.isfinite(t) & np.isfinite(wanted)
            if known.any():
                found[:, column] = np.interp(chunk.t - self.delay_s, t[known], wanted[known])
        return found - q

    def _driven(self, chunk: Chunk, error: np.ndarray, qd: np.ndarray) -> Chunk:
        assert chunk.q_ref is not None
        tau, q_ref = chunk.tau.copy(), chunk.q_ref.copy()
        q_ref[:, self.index] = chunk.q[:, self.index] + error
        for column, (joint, drive) in enumerate(self.of.items()):
            k = self.joints.index(joint)
            recorded = None if chunk.qd is None else chunk.qd[:, k]
            own = qd[:, k] if recorded is None or np.isnan(recorded).all() else recorded
            tau[:, k] = drive.torque(error[:, column], own if drive.kd else np.zeros(len(own)))
        return replace(chunk, tau=tau, q_ref=q_ref)


def _in_context(chunks: Iterable[Chunk], reach_s: float) -> Iterator[tuple[list[Chunk], Chunk, list[Chunk]]]:
    """Yield each chunk with those before and after it that are within a time of it [s], and at least one of each."""
    before, waiting = list[Chunk](), list[Chunk]()
    for chunk in chunks:
        waiting.append(chunk)
        while len(waiting) > 1 and waiting[-1].t[-1] - waiting[0].t[-1] > reach_s:
            yield before, waiting[0], waiting[1:]
            before.append(waiting.pop(0))
            while len(before) > 1 and waiting[0].t[0] - before[1].t[0] > reach_s:
                before.pop(0)
    while waiting:
        yield before, waiting[0], waiting[1:]
        before.append(waiting.pop(0))


def _without_turns(error: np.ndarray, turns: np.ndarray, last: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return position errors (N, d) without jumps by whole turns, the turns so far (d,), and the last raw errors (d,).

    Args:
        error: raw differences.
        turns: those of earlier rows.
        last: the last raw error before; NaN at the start.
    """
    error, turns, last = error.copy(), turns.copy(), last.copy()
    for k in range(error.shape[1]):
        known = np.flatnonzero(np.isfinite(error[:, k]))
        if not len(known):
            continue
        raw = error[known, k]
        jumps = np.diff(raw, prepend=raw[0] if np.isnan(last[k]) else last[k])
        whole = _turns_of(jumps)
        error[known, k] = raw - _TURN * (turns[k] + np.cumsum(whole))
        turns[k] += whole.sum()
        last[k] = raw[-1]
    return error, turns, last


def _turns_of(jumps: np.ndarray) -> np.ndarray:
    """Return the whole turns in jumps of an angle [rad]; zero for other jumps."""
    turns = np.round(jumps / _TURN)
    return np.where(np.abs(jumps - _TURN * turns) < _TURN_TOLERANCE, turns, 0.0)


def _velocity(before: Sequence[Chunk], chunk: Chunk, after: Sequence[Chunk]) -> np.ndarray:
    """Return differences of the positions over two rows (N, n) [rad/s, m/s]; over one at the ends of a recording."""
    parts = [*((one, slice(-1, None)) for one in before), (chunk, slice(None)), *((one, slice(1)) for one in after)]
    t = np.concatenate([one.t[rows] for one, rows in parts])
    q = np.concatenate([one.q[rows] for one, rows in parts])
    row = np.arange(len(chunk.t)) + len(before)
    late, early = np.minimum(row + 1, len(t) - 1), np.maximum(row - 1, 0)
    change = q[late] - q[early]
    change = change - _TURN * _turns_of(change)
    with np.errstate(divide="ignore", invalid="ignore"):
        found = change / (t[late] - t[early])[:, None]
    return np.where(np.isfinite(found), found, np.nan)
