"""Columns and torque of one joint before they are whitened, and their rows as whitening and least squares see them.

What a joint has at one moment alone, its rests and reversals, is more than half of its columns and next to none of
their entries: these columns stand last, and are multiplied where they are not zero.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from torchrbd.likelihood.brief import Brief
from torchrbd.likelihood.gaussian import Block, along, dense
from torchrbd.likelihood.noise import Noise

# Columns are brief that are zero but for this part of the rows.
_BRIEF = 0.1


@dataclass(frozen=True, eq=False)
class Unpredicted:
    """Rows of a design that a predictor leaves: of lasting columns (L, m), of brief ones (S, m), of the target (m,)."""

    predictor: np.ndarray
    lasting: np.ndarray
    brief: Brief
    target: np.ndarray


@dataclass(frozen=True, eq=False)
class Design:
    """Columns A (P_j, M) of a joint in prior coordinates, its target (M,), and which coefficients ``own`` (P_j,).

    They are multiples ``size`` (P_j,) of columns that designs of other sizes have too: ``lasting`` (L, M) and then
    ``brief`` (S, M), which are zero nearly everywhere.
    """

    lasting: np.ndarray
    own: np.ndarray
    target: np.ndarray
    brief: Brief
    size: np.ndarray
    _unpredicted: list[Unpredicted] = field(default_factory=list, repr=False)
    _independent: list[tuple[Noise, Block]] = field(default_factory=list, repr=False)

    @staticmethod
    def of(A: np.ndarray, own: np.ndarray, target: np.ndarray) -> Design:
        """Return the design of columns (P_j, M), in an order of its own."""
        brief = np.count_nonzero(A, axis=1) < _BRIEF * A.shape[1]
        order = np.argsort(brief, kind="stable")
        return Design(A[~brief], own[order], target, Brief.of(A[brief]), np.ones(len(A)))

    def sized(self, size: np.ndarray) -> Design:
        """Return the same columns with other sizes (P_j,)."""
        return replace(self, size=size)

    @property
    def A(self) -> np.ndarray:
        """All columns, (P_j, M), made anew."""
        return dense(self.size, self.lasting, self.brief)

    def explained(self, z: np.ndarray) -> np.ndarray:
        """Return z A of coefficients z (..., P_j), (..., M)."""
        return along(z * self.size, self.lasting, self.brief)

    def white(self, noise: Noise) -> Block:
        """Return the rows that a noise leaves white; those of another size are multiples of them, and remembered."""
        if not any(known.predictor is noise.predictor for known in self._unpredicted):
            self._unpredicted[:] = [Unpredicted(noise.predictor, *self._filtered(noise))]
        (known,) = self._unpredicted
        return self._weighed(known.lasting, known.brief, known.target, 1.0 / noise.size).sized(self.size)

    def independent(self, noise: Noise) -> Block:
        """Return the rows of a noise without memory; those of another size are multiples of them, and remembered."""
        for known, block in self._independent:
            if known.spread is noise.spread and known.tail is noise.tail:
                return block.louder(noise.sigma / known.sigma).sized(self.size)
        block = self._weighed(*self._filtered(noise), 1.0 / noise.size)
        self._independent[:] = [(noise, block)]
        return block.sized(self.size)

    def _filtered(self, noise: Noise) -> tuple[np.ndarray, Brief, np.ndarray]:
        """Return what rows cannot predict of lasting columns (L, m), of brief ones and of the target (m,)."""
        brief = Brief.of(noise.unpredicted(self.brief.dense))
        return noise.unpredicted(self.lasting), brief, noise.unpredicted(self.target)

    def _weighed(self, lasting: np.ndarray, brief: Brief, target: np.ndarray, precise: np.ndarray) -> Block:
        return Block(lasting * precise, target * precise, self.own, brief.scaled(precise))
