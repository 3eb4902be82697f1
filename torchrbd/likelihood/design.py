"""Columns and torque of one joint before they are whitened, and their rows as whitening and least squares see them."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from torchrbd.likelihood.gaussian import Block
from torchrbd.likelihood.noise import Noise


@dataclass(frozen=True, eq=False)
class Design:
    """Columns A (P_j, M) of a joint in prior coordinates, its target (M,), and which coefficients ``own`` (P_j,)."""

    A: np.ndarray
    own: np.ndarray
    target: np.ndarray
    _independent: list[tuple[Noise, Block]] = field(default_factory=list, repr=False)

    def white(self, noise: Noise) -> Block:
        """Return the rows that a noise leaves white."""
        return Block(noise.white(self.A), noise.white(self.target), self.own)

    def independent(self, noise: Noise) -> Block:
        """Return the rows of a noise without memory; those of another size are multiples of them, and remembered."""
        for known, block in self._independent:
            if known.spread is noise.spread and known.tail is noise.tail:
                return block.louder(noise.sigma / known.sigma)
        block = self.white(noise)
        self._independent[:] = [(noise, block)]
        return block
