"""Additional columns of a machine: a hypothesis, or an accepted term."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np


@dataclass(frozen=True)
class Extra:
    """Additional columns: features (K, M) at a joint, or (K, n, M) at all, and their prior standard deviations (K,)."""

    place: int | None
    features: np.ndarray
    std: np.ndarray

    def at(self, joint: int) -> np.ndarray | None:
        """Return the features at a joint, (K, M); None if there are none."""
        if joint not in self.joints:
            return None
        return self.features[:, joint] if self.place is None else self.features

    @cached_property
    def joints(self) -> list[int]:
        """The joints that have these features."""
        if self.place is not None:
            return [self.place]
        return np.flatnonzero(self.features.any((0, 2))).tolist()
