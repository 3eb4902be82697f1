"""Positions of slow motion, interpolated between the steps of an encoder.

While a joint creeps, its encoder shows one reading for many rows. The error of the reading is not noise but a sawtooth:
its frequency, speed over step, is within the band of the motion. At the moment of a step the position is known much
better: halfway between both readings. Let t_a, t_b be the times of the steps that begin and end a reading c, halfway
between two rows, and c + q_a, c + q_b the positions there:

    q(t) = c + h_00 q_a + h_01 q_b + T (h_10 v_a + h_11 v_b),   T = t_b - t_a

h are Hermite's cubics of (t - t_a) / T, and v the speed there of the parabola through three steps. The result stays
within half a step of c. If a reading lasts much longer than a step takes at the speeds u of the steps before and after,
the joint rests in between:

    q(t) = c + q_a [1 - (t - t_a) / H_a]_+^2 + q_b [1 - (t_b - t) / H_b]_+^2,   H = step / |u|, .5 s at most

The time of a step is known to one row only, so readings of a few rows are left as they are.

Source: Merry, van de Molengraft, Steinbuch, "Velocity and acceleration estimation for optical incremental encoders",
Mechatronics 2010 (events of an encoder instead of its samples).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from torchrbd.recordings.blocks import Block

# The longest H [s]; the least rows of a reading; the length, in its H, from which a reading holds a rest.
_LONGEST_S, _LEAST_ROWS, _RESTS = 0.5, 5, 3.0
# Least number of rows that are processed at a time.
_AT_ONCE = 256


def between_steps(blocks: Iterator[Block], step: np.ndarray) -> Iterator[Block]:
    """Yield the same rows with slow positions interpolated; the result does not depend on the cuts between blocks.

    Args:
        blocks: rows of a recording.
        step: (n,) of its positions, NaN if none is seen [rad or m].
    """
    if np.isnan(step).all():
        yield from blocks
        return
    reach = 2.0 * (_RESTS + 1.0) * _LONGEST_S
    held: Block | None = None
    done = 0
    for block in blocks:
        if held is not None and held.segment != block.segment:
            yield from _part(held, step, done, len(held.t))
            held, done = None, 0
        held = block if held is None else held.joined(block)
        known = int(np.searchsorted(held.t, held.t[-1] - reach, side="left"))
        if known >= done + _AT_ONCE:
            yield from _part(held, step, done, known)
            # The interpolation of a reading needs two steps on each side of it, which may be this far before.
            first = max(0, int(np.searchsorted(held.t, held.t[known] - reach, side="left")) - _LEAST_ROWS)
            held, done = held.rows(first, len(held.t)), known - first
    if held is not None:
        yield from _part(held, step, done, len(held.t))


def _part(block: Block, step: np.ndarray, first: int, last: int) -> Iterator[Block]:
    if last <= first:
        return
    x = block.x[:, first:last].copy()
    for joint in np.flatnonzero(~np.isnan(step)):
        x[joint] = interpolated(block.t, block.x[joint], float(step[joint]))[first:last]
    yield replace(block.rows(first, last), x=x)


class _Entry(NamedTuple):
    """How R readings begin, each (R,).

    Attributes:
        row: first one.
        t: of the step, -inf if none is seen [s].
        q: position at the step, relative to the reading [rad or m].
        gap: time since the step before [s], inf if none is seen or it is too far.
        speed: mean since then [rad/s or m/s].
    """

    row: np.ndarray
    t: np.ndarray
    q: np.ndarray
    gap: np.ndarray
    speed: np.ndarray

    @staticmethod
    def of(t: np.ndarray, q: np.ndarray, step: float) -> _Entry:
        """Return the entries of readings that last some rows, of positions (K,) at times (K,)."""
        steps = np.flatnonzero(np.diff(q)) + 1
        first = np.concatenate(([0], steps))
        k = np.flatnonzero(np.diff(np.append(first, len(q))) >= _LEAST_ROWS)
        row, before = first[k], first[k - 1]
        change = np.where(row > 0, q[row] - q[row - 1], 0.0)
        when = np.where(row > 0, 0.5 * (t[row - 1] + t[row]), -np.inf)
        seen = (row > 0) & (before > 0)
        gap = np.where(seen, when - 0.5 * (t[before - 1] + t[before]), np.inf)
        gap[gap >= 2.0 * _LONGEST_S] = np.inf
        speed = 0.5 * (change + q[before] - q[before - 1]) / gap
        return _Entry(row, when, 0.5 * np.clip(-change, -step, step), gap, speed)

    def left(self, rows: int) -> _Entry:
        """Return how readings end, with this the entries of the reversed motion and ``rows`` its number of rows."""
        row, t, q, gap, speed = (x[::-1] for x in self)
        return _Entry(rows - 1 - row, -t, q, gap, -speed)


def interpolated(t: np.ndarray, q: np.ndarray, step: float) -> np.ndarray:
    """Return positions (K,) at times (K,), slow ones interpolated between their steps."""
    a, b = _Entry.of(t, q, step), _Entry.of(-t[::-1], q[::-1], step).left(len(q))
    if not len(a.row):
        return q
    row = np.arange(len(q))
    at = np.searchsorted(a.row, row, side="right") - 1
    h_a, h_b = (np.minimum(_LONGEST_S, step / np.maximum(np.abs(e.speed), 1e-300)) for e in (a, b))
    rests = _RESTS * (h_a + h_b) < b.t - a.t
    lasts = np.where(rests, 1.0, b.t - a.t)
    own = (b.q - a.q) / lasts
    v_a, v_b = (own + (e.speed - own) * lasts / (lasts + e.gap) for e in (a, b))
    held = a.q[at] * _falling((t - a.t[at]) / h_a[at]) + b.q[at] * _falling((b.t[at] - t) / h_b[at])
    x = np.where(rests[at], 0.0, t - a.t[at]) / lasts[at]
    y = 1.0 - x
    path = a.q[at] * y**2 * (1 + 2 * x) + b.q[at] * x**2 * (1 + 2 * y) + lasts[at] * x * y * (v_a[at] * y - v_b[at] * x)
    correction = np.where(rests[at], held, np.clip(path, -0.5 * step, 0.5 * step))
    return np.where((at >= 0) & (row <= b.row[at]), q + correction, q)


def _falling(x: np.ndarray) -> np.ndarray:
    return np.clip(1.0 - x, 0.0, 1.0) ** 2
