"""A cache of arrays that are used repeatedly, within a limit of memory."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass, field

import numpy as np


@dataclass
class Remembered:
    """A cache of arrays by key, with at most ``most`` numbers in all; the first ones are kept.

    All arrays are requested in turn, each time: a cache that drops the oldest would drop each one before its turn.
    """

    most: int
    _known: dict[Hashable, np.ndarray] = field(default_factory=dict, repr=False)
    _size: int = 0

    def of(self, key: Hashable, make: Callable[[], np.ndarray]) -> np.ndarray:
        """Return the array of a key; computes it if it is not cached."""
        if key in self._known:
            return self._known[key]
        found = make()
        if self._size + found.size <= self.most:
            self._known[key] = found
            self._size += found.size
        return found
