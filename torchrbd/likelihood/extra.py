"""Columns beside a machine's: a hypothesis, or a term that stands."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np


@dataclass(frozen=True)
class Extra:
    """Columns beside the machine's: features (K, M) at a joint, or (K, n, M) at all, and their prior (K,)."""

    place: int | None
    features: np.ndarray
    std: np.ndarray

    def at(self, joint: int) -> np.ndarray | None:
        """Return what they are at a joint, (K, M); None if they are not there."""
        if joint not in self.joints:
            return None
        return self.features[:, joint] if self.place is None else self.features

    @cached_property
    def joints(self) -> list[int]:
        """The joints where they are."""
        if self.place is not None:
            return [self.place]
        return np.flatnonzero(self.features.any((0, 2))).tolist()
