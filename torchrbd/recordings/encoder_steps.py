"""An encoder tells best when it steps: between two steps, slow positions are interpolated.

While a joint creeps, its encoder shows one reading for many rows, and the error of the reading is no noise: a sawtooth
whose frequency, speed over step, lies within the band of the motion. At the moment of a step the position is known much
better: halfway between both readings. With t_a, t_b the times of the steps that begin and end a reading c, halfway
between two rows, and q_a, q_b the positions there,

    q(t) = c + (q_a - c) [1 - (t - t_a) / h]_+ + (q_b - c) [1 - (t_b - t) / h]_+,   h = min(H, (t_b - t_a) / 2)

is a straight line across a short reading, and returns to it within H of a long one. Shorter readings than 1 / 0.12 rows
are left as they are: their sawtooth is faster than any band that is fitted (``likelihood.band``), while times of steps
are told to a row alone. So are readings that are left where they were entered: how far the joint went before it turned,
or for a while stuck, steps do not tell.

Source: Merry, van de Molengraft, Steinbuch, "Velocity and acceleration estimation for optical incremental encoders",
Mechatronics 2010 (events of an encoder instead of its samples).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from torchrbd.recordings.blocks import Block

# H [s], and rows that a reading must last.
_RETURN_S, _LEAST_ROWS = 0.5, 8
# Rows that are worked on at a time, at least.
_AT_ONCE = 256


def between_steps(blocks: Iterator[Block], quantised: np.ndarray) -> Iterator[Block]:
    """Yield the same rows, slow positions interpolated; the result does not depend on how they were cut into blocks.

    Args:
        blocks: rows of a recording.
        quantised: (n,) bool, which of its positions show steps.
    """
    if not quantised.any():
        yield from blocks
        return
    joints, reach = np.flatnonzero(quantised), 2.0 * _RETURN_S
    held: Block | None = None
    done = 0
    for block in blocks:
        if held is not None and held.segment != block.segment:
            yield from _part(held, joints, done, len(held.t))
            held, done = None, 0
        held = block if held is None else held.joined(block)
        known = int(np.searchsorted(held.t, held.t[-1] - reach, side="left"))
        if known >= done + _AT_ONCE:
            yield from _part(held, joints, done, known)
            # A reading is told by the steps around it, which may be as far before.
            first = max(0, int(np.searchsorted(held.t, held.t[known] - reach, side="left")) - _LEAST_ROWS)
            held, done = held.rows(first, len(held.t)), known - first
    if held is not None:
        yield from _part(held, joints, done, len(held.t))


def _part(block: Block, joints: np.ndarray, first: int, last: int) -> Iterator[Block]:
    if last <= first:
        return
    x = block.x[:, first:last].copy()
    for joint in joints:
        x[joint] = interpolated(block.t, block.x[joint])[first:last]
    yield replace(block.rows(first, last), x=x)


def interpolated(t: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Return positions (K,) at times (K,), slow ones by the moments of their steps."""
    steps = np.flatnonzero(np.diff(q)) + 1
    number = np.searchsorted(steps, np.arange(len(q)), side="right")
    rows = np.diff(np.concatenate(([0], steps, [len(q)])))[number]
    at = np.concatenate(([-np.inf], 0.5 * (t[steps - 1] + t[steps]), [np.inf]))
    half = np.concatenate(([0.0], 0.5 * (q[steps - 1] + q[steps]), [0.0]))
    enters, leaves = (np.where(np.isfinite(at[k]), half[k] - q, 0.0) for k in (number, number + 1))
    begin, end = at[number], at[number + 1]
    h = np.minimum(_RETURN_S, 0.5 * (end - begin))
    before, after = np.clip(1.0 - (t - begin) / h, 0.0, 1.0), np.clip(1.0 - (end - t) / h, 0.0, 1.0)
    turns = (enters * leaves > 0.0) & (end - begin < 2.0 * _RETURN_S)
    slow = (rows >= _LEAST_ROWS) & ~turns
    return np.where(slow, q + before * enters + after * leaves, q)
