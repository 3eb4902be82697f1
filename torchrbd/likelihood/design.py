"""Columns and torque of one joint before they are whitened, and their rows as whitening and least squares see them.

What a joint has at one moment alone, its rests and reversals, is more than half of its columns and next to none of
their entries: these columns stand last, and are whitened and multiplied as a sparse matrix.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.sparse import csr_array

from torchrbd.likelihood.gaussian import Block, count
from torchrbd.likelihood.noise import Noise

# Columns are brief that are zero but for this part of the rows.
_BRIEF = 0.1


@dataclass(frozen=True, eq=False)
class Unpredicted:
    """Rows of a design that a predictor leaves: of lasting columns (L, m), of brief ones (S, m), of the target (m,)."""

    predictor: np.ndarray
    lasting: np.ndarray
    brief: csr_array
    target: np.ndarray


@dataclass(frozen=True, eq=False)
class Design:
    """Columns A (P_j, M) of a joint in prior coordinates, its target (M,), and which coefficients ``own`` (P_j,).

    The last of its columns, ``brief`` (S, M), are zero nearly everywhere.
    """

    A: np.ndarray
    own: np.ndarray
    target: np.ndarray
    brief: csr_array
    _unpredicted: list[Unpredicted] = field(default_factory=list, repr=False)
    _independent: list[tuple[Noise, Block]] = field(default_factory=list, repr=False)

    @staticmethod
    def of(A: np.ndarray, own: np.ndarray, target: np.ndarray) -> Design:
        """Return the design of columns (P_j, M), in an order of its own."""
        brief = np.count_nonzero(A, axis=1) < _BRIEF * A.shape[1]
        order = np.argsort(brief, kind="stable")
        return Design(A[order], own[order], target, csr_array(A[brief]))

    def white(self, noise: Noise) -> Block:
        """Return the rows that a noise leaves white; those of another size are multiples of them, and remembered."""
        if not any(known.predictor is noise.predictor for known in self._unpredicted):
            lasting = noise.unpredicted(self.A[: len(self.A) - count(self.brief)])
            target = noise.unpredicted(self.target)
            self._unpredicted[:] = [Unpredicted(noise.predictor, lasting, self.brief @ noise.band, target)]
        (known,) = self._unpredicted
        precise = 1.0 / noise.size
        brief = known.brief.copy()
        brief.data *= precise[brief.indices]
        X = np.concatenate((known.lasting * precise, brief.toarray()))
        return Block(X, known.target * precise, self.own, brief)

    def independent(self, noise: Noise) -> Block:
        """Return the rows of a noise without memory; those of another size are multiples of them, and remembered."""
        for known, block in self._independent:
            if known.spread is noise.spread and known.tail is noise.tail:
                return block.louder(noise.sigma / known.sigma)
        block = Block(noise.white(self.A), noise.white(self.target), self.own)
        self._independent[:] = [(noise, block)]
        return block
