"""An effect or a smooth curve as a component of the model: additional columns with a prior of their own."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from torchrbd.nuisance.component import Along, Component, Learnt


@dataclass(frozen=True)
class Extra(Component):
    """Additional columns: features (K, M) at a joint, or (K, n, M) at all, and their prior standard deviations (K,).

    Its indices count from its own first coefficient.
    """

    place: int | None
    features: np.ndarray
    std: np.ndarray

    @property
    def n(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        return len(self.std)

    @property
    def local(self) -> bool:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.place is not None

    @cached_property
    def joints(self) -> list[int]:
        """The joints that have these features."""
        if self.place is not None:
            return [self.place]
        return np.flatnonzero(self.features.any((0, 2))).tolist()

    def at(self, joint: int) -> np.ndarray:
        return np.arange(self.n if joint in self.joints else 0)

    def columns(
        self, joint: int, learnt: Learnt | None = None, along: Along | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        at = self.at(joint)
        every = self.features[:, joint] if self.place is None else self.features
        return every[: len(at)], at

    def sizes(self, joint: int, own: np.ndarray, learnt: Learnt | None = None) -> np.ndarray:
        return self.std[own]
