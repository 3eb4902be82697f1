"""Blocks of rows, an intermediate form between a recording and its states."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

Ends = tuple[int, int, int]
"""Ends of x, of the set-points and of the positions behind gears among the channels of a block."""


@dataclass(frozen=True)
class Block:
    """Consecutive samples of one segment.

    Attributes:
        segment: index of the segment.
        t: (K,) [s].
        x: (C, K) channels: q, tau, then qd if the recording has it.
        q_ref: (r, K) set-points of the joints whose set-point is used, or None.
        q_link: (l, K) positions behind the gear of the joints that have them, or None.
        temperature: (m, K) of the joints that have one, or None.
    """

    segment: int
    t: np.ndarray
    x: np.ndarray
    q_ref: np.ndarray | None = None
    q_link: np.ndarray | None = None
    temperature: np.ndarray | None = None

    @property
    def channels(self) -> np.ndarray:
        """Return x, q_ref, q_link and temperature as one array."""
        parts = (self.x, self.q_ref, self.q_link, self.temperature)
        return np.concatenate([one for one in parts if one is not None])

    @property
    def ends(self) -> Ends:
        """Return where in the channels x, q_ref and q_link end."""
        lengths = (len(self.x), *(0 if one is None else len(one) for one in (self.q_ref, self.q_link)))
        return lengths[0], lengths[0] + lengths[1], sum(lengths)

    def rows(self, first: int, last: int) -> Block:
        """Return the rows from ``first`` up to, not including, ``last``."""
        return split(self.segment, self.t[first:last], self.channels[:, first:last], self.ends)

    def joined(self, later: Block) -> Block:
        """Return these rows followed by later ones of the same segment."""
        channels = np.concatenate((self.channels, later.channels), axis=1)
        return split(self.segment, np.concatenate((self.t, later.t)), channels, self.ends)


def split(segment: int, t: np.ndarray, channels: np.ndarray, ends: Ends) -> Block:
    """Split channels (C, K) at the ends of x, set-points and positions behind gears; temperatures may follow."""
    x, *others = np.split(channels, ends)
    return Block(segment, t, x, *(one if len(one) else None for one in others))
