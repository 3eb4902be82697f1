"""Arrays that are asked for again and again, kept as long as memory allows."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass, field

import numpy as np


@dataclass
class Remembered:
    """Arrays by what they are, of no more than ``most`` numbers together; those asked for first are kept.

    They are asked for in turns, all of them each time: what was asked for last would be forgotten before its turn.
    """

    most: int
    _known: dict[Hashable, np.ndarray] = field(default_factory=dict, repr=False)
    _size: int = 0

    def of(self, key: Hashable, make: Callable[[], np.ndarray]) -> np.ndarray:
        """Return the array of a key, made if it is not known."""
        if key in self._known:
            return self._known[key]
        found = make()
        if self._size + found.size <= self.most:
            self._known[key] = found
            self._size += found.size
        return found
