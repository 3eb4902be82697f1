"""Statistics of a recording's columns as they are written: range, noise, values that are held or clipped."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from torchrbd.recordings.chunk import Chunk
from torchrbd.recordings.recording import Recording

SIGNALS = ("q", "qd", "tau")
# Third differences of white noise have 20 times its variance.
_THIRD, _MAD = np.sqrt(20.0), 1.4826
# A clipped signal reaches its limit repeatedly, for at least three rows, for this share of the time, and this many
# times as often as values just below it.
_RUNS, _SHARE, _PILE = 2, 1e-3, 4.0
# If a signal without steps changes in a smaller share of the rows than this, its source is slower than the rows.
_HELD = 0.6


@dataclass(frozen=True)
class Channel:
    """Description of the column of one joint's signal.

    Attributes:
        joint, signal: the joint, and "q", "qd" or "tau".
        column: its name in the file.
        low, high: smallest and largest value [SI].
        noise_std: of the white noise, from third differences [SI].
        missing: number of rows without a value.
        clipped_low, clipped_high: whether values are clipped there.
        held_rows: mean number of rows for which a value stays the same, 1.0 if it changes in every row; NaN for a
            signal with steps or without changes.
    """

    joint: str
    signal: str
    column: str
    low: float
    high: float
    noise_std: float
    missing: int
    clipped_low: bool
    clipped_high: bool
    held_rows: float


def channels_of(recording: Recording, resolution: dict[str, np.ndarray]) -> tuple[Channel, ...]:
    """Stream a recording twice and describe its columns.

    Args:
        recording: the recording.
        resolution: (n,) quantisation steps of q and tau, by signal; NaN if none was found.
    """
    present = [s for s in SIGNALS if any(recording.source(s, joint) for joint in recording.joints)]
    scans = {signal: _Scan(len(recording.joints)) for signal in present}
    for chunk in recording.chunks():
        for signal, scan in scans.items():
            scan.add(_values(chunk, signal))
    limits = {
        signal: _Limits(scan.low, scan.high, resolution.get(signal, np.full(len(scan.low), np.nan)))
        for signal, scan in scans.items()
    }
    for chunk in recording.chunks():
        for signal, limit in limits.items():
            limit.add(_values(chunk, signal))
    found = []
    for signal, scan in scans.items():
        low, high = limits[signal].reached
        for k, joint in enumerate(recording.joints):
            source = recording.source(signal, joint)
            if source is not None:
                cut = signal != "q"  # a robot may rest at its range's end
                step = np.isfinite(resolution.get(signal, np.full(len(low), np.nan))[k])
                found.append(
                    Channel(
                        joint,
                        signal,
                        source.column,
                        float(scan.low[k]),
                        float(scan.high[k]),
                        float(scan.noise_std[k]),
                        int(scan.missing[k]),
                        bool(cut and low[k]),
                        bool(cut and high[k]),
                        float("nan") if step else float(scan.held_rows[k]),
                    )
                )
    return tuple(found)


def _values(chunk: Chunk, signal: str) -> np.ndarray:
    return getattr(chunk, signal)


class _Scan:
    """Accumulate range, noise and changes of n channels."""

    def __init__(self, n: int):
        self.low, self.high = np.full(n, np.inf), np.full(n, -np.inf)
        self.missing = np.zeros(n, dtype=int)
        self._noise: list[np.ndarray] = []
        self._changes, self._pairs = np.zeros(n), 0

    def add(self, x: np.ndarray) -> None:
        """Add rows (N, n)."""
        self.missing += np.isnan(x).sum(axis=0)
        self.low, self.high = np.fmin(self.low, np.fmin.reduce(x)), np.fmax(self.high, np.fmax.reduce(x))
        self._changes += (np.diff(x, axis=0) != 0).sum(axis=0)
        self._pairs += len(x) - 1
        if len(x) > 8:
            self._noise.append(_MAD * _median(np.abs(np.diff(x, n=3, axis=0))) / _THIRD)

    @property
    def noise_std(self) -> np.ndarray:
        return _median(np.array(self._noise).reshape(-1, len(self.low)))

    @property
    def held_rows(self) -> np.ndarray:
        """Mean number of rows for which a value stays the same, NaN if it never changes."""
        share = np.where(self._changes > 0, self._changes / max(self._pairs, 1), np.nan)
        return np.where(share < _HELD, 1 / share, np.where(np.isnan(share), np.nan, 1.0))


def _median(x: np.ndarray) -> np.ndarray:
    """Return the median of x (N, n) without NaN, channel by channel; NaN for a channel that is all NaN."""
    found, seen = np.full(x.shape[1], np.nan), ~np.isnan(x).all(axis=0)
    found[seen] = np.nanmedian(x[:, seen], axis=0)
    return found


class _Limits:
    """Count how often n channels stay at their smallest and largest value."""

    def __init__(self, low: np.ndarray, high: np.ndarray, step: np.ndarray):
        self._bounds, self._step = np.stack([low, high]), step
        self._runs, self._held, self._at, self._near = np.zeros((4, 2, len(low)))
        self._rows = 0

    def add(self, x: np.ndarray) -> None:
        """Add rows (N, n)."""
        self._rows += len(x)
        for side, bound in enumerate(self._bounds):
            away = np.abs(x - bound)
            at = away <= 1e-9 * (self._bounds[1] - self._bounds[0])
            three = at[2:] & at[1:-1] & at[:-2]
            self._held[side] += three.sum(axis=0)
            self._runs[side] += (three[1:] & ~three[:-1]).sum(axis=0) + (three[0] if len(three) else 0)
            self._at[side] += at.sum(axis=0)
            self._near[side] += (~at & (away < 1.5 * self._step)).sum(axis=0)

    @property
    def reached(self) -> tuple[np.ndarray, np.ndarray]:
        """(n,) bool twice: clipped at the smallest, at the largest value."""
        moves = self._bounds[1] > self._bounds[0]
        often = (self._runs >= _RUNS) & (self._held >= _SHARE * self._rows) & (self._at > _PILE * self._near)
        low, high = often & moves
        return low, high
