"""Columns and torque of one joint before they are whitened, and their rows as whitening and least squares see them.

What a joint has at one moment alone, its rests and reversals, is more than half of its columns and next to none of
their entries: these columns stand last, and are multiplied where they are not zero. Further columns stand before those
of the machine, whose rows serve whatever stands beside them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from torchrbd.likelihood.block import Block, along, dense
from torchrbd.likelihood.brief import Brief
from torchrbd.likelihood.extra import Extra
from torchrbd.likelihood.noise import Noise

# Columns are brief that are zero but for this part of the rows.
_BRIEF = 0.1

Extras = Sequence[tuple[int, Extra]]
"""What stands beside a machine at one joint, each with the number of its first coefficient."""


@dataclass(frozen=True, eq=False)
class Unpredicted:
    """Rows of a design that a predictor leaves: of lasting columns (L, m), of brief ones (S, m), of the target (m,)."""

    predictor: np.ndarray
    lasting: np.ndarray
    brief: Brief
    target: np.ndarray


@dataclass(frozen=True, eq=False)
class Bare:
    """Columns of a joint that the machine has: ``lasting`` (L, M) and then ``brief`` (S, M), zero nearly everywhere.

    Its target (M,), and which coefficients ``own`` (L + S,) the columns are multiplied with.
    """

    lasting: np.ndarray
    brief: Brief
    own: np.ndarray
    target: np.ndarray
    _unpredicted: list[Unpredicted] = field(default_factory=list, repr=False)
    _independent: list[tuple[Noise, Block]] = field(default_factory=list, repr=False)

    @staticmethod
    def of(A: np.ndarray, own: np.ndarray, target: np.ndarray) -> Bare:
        """Return columns (P_j, M), in an order of their own."""
        brief = np.count_nonzero(A, axis=1) < _BRIEF * A.shape[1]
        return Bare(A[~brief], Brief.of(A[brief]), own[np.argsort(brief, kind="stable")], target)

    def white(self, noise: Noise) -> Block:
        """Return the rows that a noise leaves white; what its predictor leaves is remembered."""
        if not any(known.predictor is noise.predictor for known in self._unpredicted):
            self._unpredicted[:] = [Unpredicted(noise.predictor, *self._filtered(noise))]
        (known,) = self._unpredicted
        return self._weighed(known.lasting, known.brief, known.target, noise)

    def independent(self, noise: Noise) -> Block:
        """Return the rows of a noise without memory; those of another size are multiples of them, and remembered."""
        for known, block in self._independent:
            if known.spread is noise.spread and known.tail is noise.tail:
                return block.louder(noise.sigma / known.sigma)
        block = self._weighed(*self._filtered(noise), noise)
        self._independent[:] = [(noise, block)]
        return block

    def _filtered(self, noise: Noise) -> tuple[np.ndarray, Brief, np.ndarray]:
        """Return what rows cannot predict of lasting columns (L, m), of brief ones and of the target (m,)."""
        brief = self.brief.unpredicted(noise.predictor, noise.index)
        return noise.unpredicted(self.lasting), brief, noise.unpredicted(self.target)

    def _weighed(self, lasting: np.ndarray, brief: Brief, target: np.ndarray, noise: Noise) -> Block:
        precise = 1.0 / noise.size
        return Block(lasting * precise, target * precise, self.own, brief.scaled(precise))


@dataclass(frozen=True, eq=False)
class Design:
    """Columns of a joint: further ones (K, M) and then those of the machine, multiples ``size`` (K + P,) of these.

    ``own`` (K + P,) says which coefficients they have, ``extras`` whose the further ones are.
    """

    bare: Bare
    extras: Extras
    further: np.ndarray
    own: np.ndarray
    size: np.ndarray

    @staticmethod
    def of(bare: Bare, extras: Extras, joint: int) -> Design:
        """Return the columns of a machine at a joint, and what stands beside them there."""
        parts = [e.at(joint) * e.std[:, None] for _, e in extras]
        further = np.concatenate((np.zeros((0, len(bare.target))), *parts))
        own = np.concatenate([*(first + np.arange(len(e.std)) for first, e in extras), bare.own])
        return Design(bare, extras, further, own, np.ones(len(own)))

    def has(self, extras: Extras) -> bool:
        """Say whether just this stands beside the machine."""
        pairs = zip(self.extras, extras, strict=False)
        return len(self.extras) == len(extras) and all(k == i and e is one for (k, e), (i, one) in pairs)

    def sized(self, size: np.ndarray) -> Design:
        """Return the same columns with other sizes (K + P,)."""
        return replace(self, size=size)

    @property
    def target(self) -> np.ndarray:
        """What the columns are to explain, (M,)."""
        return self.bare.target

    @property
    def A(self) -> np.ndarray:
        """All columns, (K + P, M), made anew."""
        return dense(self.size, np.concatenate((self.further, self.bare.lasting)), self.bare.brief)

    def explained(self, z: np.ndarray) -> np.ndarray:
        """Return z A of coefficients z (..., K + P), (..., M)."""
        z, k = z * self.size, len(self.further)
        return z[..., :k] @ self.further + along(z[..., k:], self.bare.lasting, self.bare.brief)

    def white(self, noise: Noise, bare: Block | None = None) -> Block:
        """Return the rows that a noise leaves white, of which those of the machine may be known: its ``bare`` block."""
        return self._with_further(self.bare.white(noise) if bare is None else bare, noise)

    def independent(self, noise: Noise) -> Block:
        """Return the rows of a noise without memory."""
        return self._with_further(self.bare.independent(noise), noise)

    def _with_further(self, bare: Block, noise: Noise) -> Block:
        k = len(self.further)
        size = self.size.copy()
        size[k:] *= bare.size
        if not k:
            return replace(bare, size=size, bare=bare)
        lasting = np.concatenate((noise.white(self.further), bare.lasting))
        return Block(lasting, bare.y, self.own, bare.brief, size, bare)
