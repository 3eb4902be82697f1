"""Turn raw rows into uninterrupted segments on a uniform clock."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from torchrbd.errors import RecordingError
from torchrbd.recordings.blocks import Block, split
from torchrbd.recordings.chunk import Chunk
from torchrbd.recordings.encoder_steps import between_steps
from torchrbd.recordings.recording import Recording

_GAP = 5.0
_DUPLICATE = 0.1
_REGULAR = 0.02
_WRAP_TOLERANCE = 0.2
_STENCIL = 4
_FIRST_ROWS = 16384
# Number of position changes that show a quantisation step; the second number holds for a joint that is mostly still.
_ENOUGH_STEPS, _ENOUGH_WHERE_STILL, _MOSTLY_STILL = 50, 5, 0.1
_FEW = 20


@dataclass(frozen=True)
class Clock:
    """The uniform clock of a recording, and its limits for gaps and duplicates.

    Attributes:
        dt: interval of the uniform clock [s].
        gap: rows further apart than this [s] start a new segment; nothing is interpolated across.
        duplicate: rows closer than this [s] to the row before are dropped.
        regular: whether rows are on the uniform clock, apart from rounding; others are interpolated, which smooths
            noise.
        step: (n,) quantisation step of a joint's positions, NaN if none is seen [rad or m].
    """

    dt: float
    gap: float
    duplicate: float
    regular: bool = True
    step: tuple[float, ...] = ()

    @staticmethod
    def of(recording: Recording) -> Clock:
        """Estimate the clock from the first rows: the mean interval, or that of the usual ones if they are nine in ten.

        Raises: RecordingError if there are too few rows.
        """
        t, q = np.empty(0), np.empty((0, len(recording.joints)))
        for chunk in recording.chunks():
            t, q = (np.concatenate(x)[:_FIRST_ROWS] for x in ((t, chunk.t), (q, chunk.q)))
            if len(t) == _FIRST_ROWS:
                break
        steps = np.diff(t[~np.isnan(t)])
        steps = steps[steps > 0]
        if len(steps) < 2 * _STENCIL:
            part = "" if recording.time is None else f" between {recording.time[0]:g} and {recording.time[1]:g} s"
            raise RecordingError(
                f"{recording.path or recording.name}: only {len(t)} rows with {len(steps) + 1} different times{part}; "
                f"that is too short to learn anything from"
            )
        median = float(np.median(steps))
        steps = steps[(steps >= _DUPLICATE * median) & (steps <= _GAP * median)]
        typical = np.abs(steps - median) <= _REGULAR * median
        regular = bool(typical.mean() >= 0.9)
        if regular:  # a regular clock that lost some rows keeps its rate
            steps = steps[typical]
        # nine digits: .001 stays .001 for all roundings of the times
        of_q = tuple(_step_of(changes) for changes in np.diff(q, axis=0).T)
        return Clock(float(f"{steps.mean():.9g}"), _GAP * median, _DUPLICATE * median, regular, of_q)


class Census:
    """Counts of what cleaning removed or repaired, while the rows of n joints stream by.

    Attributes:
        rows, duplicates, incomplete: rows read; of these, dropped as repeated in time, or with a missing value.
        missing: (2 n,) rows without a number in a position or a torque.
        wrapped: joints whose full turns were unwrapped.
        resolution, tau_resolution: (n,) quantisation steps of positions and torques, NaN if none is seen.
    """

    def __init__(self, n: int):
        self.rows = self.duplicates = self.incomplete = 0
        self.missing = np.zeros(2 * n, dtype=int)
        self.wrapped: set[int] = set()
        self.resolution, self.tau_resolution = np.full((2, n), np.nan)

    def see_steps(self, q: np.ndarray, tau: np.ndarray) -> None:
        """Search quantisation steps in changes of positions and torques, (n, N) each."""
        for joint, changes in enumerate(q):
            self.resolution[joint] = np.fmin(self.resolution[joint], _step_of(changes))
        for joint, changes in enumerate(tau):
            self.tau_resolution[joint] = np.fmin(self.tau_resolution[joint], _step_of(changes))


def _step_of(changes: np.ndarray) -> float:
    """Return the quantisation step of a signal from its changes (N,): most are small multiples of the smallest."""
    size = np.abs(changes[np.isfinite(changes)])
    still, size = len(size) and np.mean(size > 0) < _MOSTLY_STILL, size[size > 0]
    if len(size) < (_ENOUGH_WHERE_STILL if still else _ENOUGH_STEPS):
        return np.nan
    smallest = np.percentile(size, 1)
    # The smallest change includes the file's rounding: average over all changes of one step.
    single = size[size < 1.5 * smallest].mean()
    few = size[size < _FEW * single] / single
    quantised = len(few) >= 0.2 * len(size) and np.mean(np.abs(few - np.round(few)) < 0.1) > 0.95
    return single if quantised else np.nan


def clean_blocks(recording: Recording, clock: Clock, census: Census | None = None) -> Iterator[Block]:
    """Yield the usable raw rows: no missing values, no duplicates, turns of continuous joints unwrapped, gaps split."""
    n = len(recording.joints)
    census = census if census is not None else Census(n)
    width = n * (2 + recording.has_velocity)
    with_reference = width + int(recording.referenced.sum())
    ends = width, with_reference, with_reference + int(recording.linked.sum())
    angles = np.r_[:n, ends[0] : ends[2]]
    warmth = np.full((int(recording.thermal.sum()), 1), np.nan)
    segment, latest, q_latest, turns = 0, -np.inf, None, np.zeros((len(angles), 1))
    for chunk in recording.chunks():
        t, x = _channels(chunk, recording)
        x[ends[2] :] = _held(x[ends[2] :], warmth)
        warmth = x[ends[2] :, -1:].copy()
        census.rows += len(t)
        complete = ~(np.isnan(t) | np.isnan(x[_required(recording, len(x))]).any(axis=0))
        census.incomplete += int(len(t) - complete.sum())
        census.missing += np.isnan(x[: 2 * n]).sum(axis=1)
        t, x = t[complete], x[:, complete]
        fresh = np.diff(t, prepend=latest) >= clock.duplicate
        census.duplicates += int(len(t) - fresh.sum())
        t, x = t[fresh], x[:, fresh]
        if not len(t):
            continue
        q = x[angles]
        jumps = np.diff(q, axis=1, prepend=q[:, :1] if q_latest is None else q_latest)
        q_latest = q[:, -1:].copy()
        whole = np.round(jumps / (2 * np.pi))
        whole[np.abs(jumps - 2 * np.pi * whole) > _WRAP_TOLERANCE] = 0
        census.wrapped.update(np.flatnonzero(whole[:n].any(axis=1)).tolist())
        total = turns + np.cumsum(whole, axis=1)
        x[angles] -= 2 * np.pi * total
        census.see_steps(np.where(whole == 0, jumps, 0)[:n], np.diff(x[n : 2 * n], axis=1))
        turns = total[:, -1:]
        starts = np.flatnonzero(np.diff(t, prepend=latest if np.isfinite(latest) else t[0]) > clock.gap)
        latest = t[-1]
        for piece, (start, end) in enumerate(zip((0, *starts), (*starts, len(t)), strict=True)):
            segment += piece > 0
            if end > start:
                yield split(segment, t[start:end], x[:, start:end], ends)


def uniform_blocks(recording: Recording, clock: Clock, census: Census | None = None) -> Iterator[Block]:
    """Yield the clean rows interpolated at `t_k = t_start + k dt` within each segment.

    Interpolation is by local cubics through the four nearest rows; a sample on a row equals that row. The result does
    not depend on the chunks of rows. Segments of fewer than four rows are omitted. So are the ends of segments where a
    delayed torque is missing.
    """
    held: _Resampler | None = None
    for block in between_steps(clean_blocks(recording, clock, census), np.array(clock.step)):
        if held is not None and held.segment != block.segment:
            yield from held.advance(last=True)
            held = None
        if held is None:
            held = _Resampler(recording, clock.dt, block)
        held.append(block)
        yield from held.advance(last=False)
    if held is not None:
        yield from held.advance(last=True)


class _Resampler:
    """Interpolate one segment as its rows arrive.

    Args:
        recording: its torques may have a delay.
        dt: interval of the uniform clock [s].
        first: the segment's first rows.
    """

    def __init__(self, recording: Recording, dt: float, first: Block):
        n, self._late = len(recording.joints), recording.torque_delay_s
        early = dt * np.ceil(max(0.0, -self._late) / dt - 1e-6)
        self.segment, self._dt, self._start, self._next = first.segment, dt, float(first.t[0] + early), 0
        self._ends, self._torques = first.ends, slice(n, 2 * n)
        self._t, self._x = np.empty(0), np.empty((0, 0))

    def append(self, block: Block) -> None:
        self._t = np.concatenate([self._t, block.t])
        self._x = np.concatenate([self._x, block.channels], axis=1) if self._x.size else block.channels

    def advance(self, last: bool) -> Iterator[Block]:
        """Yield the samples whose four nearest rows are known."""
        if len(self._t) < _STENCIL:
            return
        end = (self._t[-1] + 1e-6 * self._dt if last else self._t[-2]) - max(0.0, self._late)
        count = max(0, int((end - self._start) / self._dt) + 2 - self._next)
        t = self._start + self._dt * np.arange(self._next, self._next + count)
        t = t[t <= end] if last else t[t < end]
        if not len(t):
            return
        used, x = self._at(t, self._x)
        if self._late:
            of_torque, x[self._torques] = self._at(t + self._late, self._x[self._torques])
            used = min(used, of_torque)
        self._next += len(t)
        self._t, self._x = self._t[used:], self._x[:, used:]
        yield split(self.segment, t, x, self._ends)

    def _at(self, t: np.ndarray, x: np.ndarray) -> tuple[int, np.ndarray]:
        """Return the first row that is still needed, and rows x (C, K) interpolated at t (M,), (C, M)."""
        first = np.clip(np.searchsorted(self._t, t, side="right") - 2, 0, len(self._t) - _STENCIL)
        weights = _cubic_weights(self._t[first[:, None] + np.arange(_STENCIL)].T, t)
        return max(0, int(first[-1])), np.asarray(sum(weights[k] * x[:, first + k] for k in range(_STENCIL)))


def _held(x: np.ndarray, before: np.ndarray) -> np.ndarray:
    """Return slow channels (m, K) that hold their last reading (m, 1); the first reading also counts before it."""
    if not x.size:
        return x
    x = np.concatenate([before, x], axis=1)
    known = ~np.isnan(x)
    last = np.maximum.accumulate(np.where(known, np.arange(x.shape[1]), 0), axis=1)
    last = np.maximum(last, known.argmax(axis=1)[:, None])
    return np.take_along_axis(x, last, axis=1)[:, 1:]


def _cubic_weights(nodes: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Return Lagrange's weights (4, K) at t (K,) for nodes (4, K)."""
    weights = np.ones_like(nodes)
    for k in range(_STENCIL):
        for other in range(_STENCIL):
            if other != k:
                weights[k] *= (t - nodes[other]) / (nodes[k] - nodes[other])
    return weights


def _channels(chunk: Chunk, recording: Recording) -> tuple[np.ndarray, np.ndarray]:
    link = None if chunk.q_link is None else chunk.q_link[:, recording.linked]
    warmth = None if chunk.temperature is None else chunk.temperature[:, recording.thermal]
    qd = chunk.qd if recording.has_velocity else None
    q_ref = None if chunk.q_ref is None else chunk.q_ref[:, recording.referenced]
    signals = (chunk.q, chunk.tau, qd, q_ref, link, warmth)
    return chunk.t, np.concatenate([s for s in signals if s is not None], axis=1).T.copy()


def _required(recording: Recording, channels: int) -> np.ndarray:
    """Return which channels must be numbers: all except torques that the file does not have."""
    required = np.ones(channels, dtype=bool)
    n = len(recording.joints)
    required[n : 2 * n] = recording.measured
    return required
