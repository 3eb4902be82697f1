"""Columns and torque of one joint before they are whitened, and their rows as whitening and least squares see them.

What a joint has at one moment alone, its rests and reversals, is more than half of its columns and next to none of
their entries: these columns stand last, and are whitened and multiplied as a sparse matrix.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.sparse import csr_array

from torchrbd.likelihood.gaussian import Block, along, dense
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

    They are multiples ``size`` (P_j,) of columns that designs of other sizes have too: ``lasting`` (L, M) and then
    ``brief`` (S, M), which are zero nearly everywhere.
    """

    lasting: np.ndarray
    own: np.ndarray
    target: np.ndarray
    brief: csr_array
    size: np.ndarray
    _unpredicted: list[Unpredicted] = field(default_factory=list, repr=False)
    _independent: list[tuple[Noise, Block]] = field(default_factory=list, repr=False)

    @staticmethod
    def of(A: np.ndarray, own: np.ndarray, target: np.ndarray) -> Design:
        """Return the design of columns (P_j, M), in an order of its own."""
        brief = np.count_nonzero(A, axis=1) < _BRIEF * A.shape[1]
        order = np.argsort(brief, kind="stable")
        return Design(A[~brief], own[order], target, csr_array(A[brief]), np.ones(len(A)))

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
            lasting = noise.unpredicted(self.lasting)
            target = noise.unpredicted(self.target)
            self._unpredicted[:] = [Unpredicted(noise.predictor, lasting, self.brief @ noise.band, target)]
        (known,) = self._unpredicted
        precise = 1.0 / noise.size
        brief = _scaled(known.brief, precise)
        return Block(known.lasting * precise, known.target * precise, self.own, brief, self.size)

    def independent(self, noise: Noise) -> Block:
        """Return the rows of a noise without memory; those of another size are multiples of them, and remembered."""
        for known, block in self._independent:
            if known.spread is noise.spread and known.tail is noise.tail:
                return block.louder(noise.sigma / known.sigma).sized(self.size)
        brief = _scaled(self.brief @ noise.band, 1.0 / noise.size)
        block = Block(noise.white(self.lasting), noise.white(self.target), self.own, brief)
        self._independent[:] = [(noise, block)]
        return block.sized(self.size)


def _scaled(rows: csr_array, by: np.ndarray) -> csr_array:
    """Return a sparse matrix (S, m) with its columns multiplied by numbers (m,)."""
    found = rows.copy()
    found.data *= by[found.indices]
    return found
