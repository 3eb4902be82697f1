"""Columns and torque of one joint before whitening, and their rows for generalised and ordinary least squares.

More than half of a joint's columns belong to single rests and reversals, and are almost all zero. These sparse columns
come last and are multiplied only where they are not zero. Additional columns come before those of the machine, so the
machine's rows can be reused with any of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from torchrbd.likelihood.block import Block, along, dense
from torchrbd.likelihood.brief import Brief
from torchrbd.likelihood.extra import Extra
from torchrbd.likelihood.noise import Noise

# Columns that are nonzero in less than this fraction of the rows are stored as sparse.
_BRIEF = 0.1

Extras = Sequence[tuple[int, Extra]]
"""Additional columns at one joint, each with the index of its first coefficient."""


@dataclass(frozen=True, eq=False)
class Unpredicted:
    """Prediction errors of a design: of lasting columns (L, m), of sparse ones (S, m), of the target (m,)."""

    predictor: np.ndarray
    lasting: np.ndarray
    brief: Brief
    target: np.ndarray


@dataclass(frozen=True, eq=False)
class Bare:
    """Columns of the machine at a joint: ``lasting`` (L, M), then sparse ``brief`` ones (S, M).

    Its target (M,), and the coefficients ``own`` (L + S,) of the columns.
    """

    lasting: np.ndarray
    brief: Brief
    own: np.ndarray
    target: np.ndarray
    _unpredicted: list[Unpredicted] = field(default_factory=list, repr=False)
    _independent: list[tuple[Noise, Block]] = field(default_factory=list, repr=False)

    @staticmethod
    def of(A: np.ndarray, own: np.ndarray, target: np.ndarray) -> Bare:
        """Sort columns (P_j, M) into lasting and sparse ones."""
        brief = np.count_nonzero(A, axis=1) < _BRIEF * A.shape[1]
        return Bare(A[~brief], Brief.of(A[brief]), own[np.argsort(brief, kind="stable")], target)

    def white(self, noise: Noise) -> Block:
        """Return the rows whitened by a noise; the prediction errors are cached."""
        if not any(known.predictor is noise.predictor for known in self._unpredicted):
            self._unpredicted[:] = [Unpredicted(noise.predictor, *self._filtered(noise))]
        (known,) = self._unpredicted
        return self._weighed(known.lasting, known.brief, known.target, noise)

    def independent(self, noise: Noise) -> Block:
        """Return the rows for a noise without memory; those of another size are multiples of them, and cached."""
        for known, block in self._independent:
            if known.spread is noise.spread and known.tail is noise.tail:
                return block.louder(noise.sigma / known.sigma)
        block = self._weighed(*self._filtered(noise), noise)
        self._independent[:] = [(noise, block)]
        return block

    def _filtered(self, noise: Noise) -> tuple[np.ndarray, Brief, np.ndarray]:
        """Return the prediction errors of lasting columns (L, m), of sparse ones and of the target (m,)."""
        brief = self.brief.unpredicted(noise.predictor, noise.index)
        return noise.unpredicted(self.lasting), brief, noise.unpredicted(self.target)

    def _weighed(self, lasting: np.ndarray, brief: Brief, target: np.ndarray, noise: Noise) -> Block:
        precise = 1.0 / noise.size
        return Block(lasting * precise, target * precise, self.own, brief.scaled(precise))


@dataclass(frozen=True, eq=False)
class Design:
    """Columns of a joint: additional ones (K, M), then those of the machine, multiplied by ``size`` (K + P,).

    ``own`` (K + P,) are their coefficients; ``extras`` are the additional columns.
    """

    bare: Bare
    extras: Extras
    further: np.ndarray
    own: np.ndarray
    size: np.ndarray
    _independent: list[tuple[Noise, Block]] = field(default_factory=list, repr=False)

    @staticmethod
    def of(bare: Bare, extras: Extras, joint: int) -> Design:
        """Return the columns of a machine at a joint, and the additional ones there, without their sizes."""
        parts = [e.columns(joint)[0] for _, e in extras]
        further = np.concatenate((np.zeros((0, len(bare.target))), *parts))
        own = np.concatenate([*(first + e.at(joint) for first, e in extras), bare.own])
        return Design(bare, extras, further, own, np.ones(len(own)))

    def has(self, extras: Extras) -> bool:
        """Return whether exactly these are the additional columns."""
        pairs = zip(self.extras, extras, strict=False)
        return len(self.extras) == len(extras) and all(k == i and e is one for (k, e), (i, one) in pairs)

    def places(self, extras: Extras, joint: int) -> tuple[np.ndarray, np.ndarray] | None:
        """Return which columns (K + P,) some of its additional columns are, and the coefficients of these.

        None if others are among them, or their order differs.
        """
        wanted, kept, own = [*extras], list[np.ndarray](), list[np.ndarray]()
        for _, e in self.extras:
            there = bool(wanted) and wanted[0][1] is e
            at = e.at(joint)
            kept.append(np.full(len(at), there))
            own.append(wanted.pop(0)[0] + at if there else at)
        if wanted:
            return None
        return np.concatenate((*kept, np.ones(len(self.bare.own), bool))), np.concatenate((*own, self.bare.own))

    def some(self, extras: Extras, kept: np.ndarray, own: np.ndarray) -> Design:
        """Return the same with some of its additional columns, see ``places``."""
        further = self.further if kept.all() else self.further[kept[: len(self.further)]]
        known = [(noise, block.some(kept, own)) for noise, block in self._independent]
        return Design(self.bare, extras, further, own[kept], self.size[kept], known)

    def sized(self, size: np.ndarray) -> Design:
        """Return the same columns with other sizes (K + P,)."""
        return self if np.array_equal(size, self.size) else replace(self, size=size)

    @property
    def target(self) -> np.ndarray:
        """The torque to explain, (M,)."""
        return self.bare.target

    @property
    def A(self) -> np.ndarray:
        """All columns, (K + P, M), computed anew."""
        return dense(self.size, np.concatenate((self.further, self.bare.lasting)), self.bare.brief)

    def explained(self, z: np.ndarray) -> np.ndarray:
        """Return z A for coefficients z (..., K + P), (..., M)."""
        z, k = z * self.size, len(self.further)
        return z[..., :k] @ self.further + along(z[..., k:], self.bare.lasting, self.bare.brief)

    def white(self, noise: Noise, bare: Block | None = None) -> Block:
        """Return the rows whitened by a noise; those of the machine may be given: its ``bare`` block."""
        return self._with_further(self.bare.white(noise) if bare is None else bare, noise)

    def independent(self, noise: Noise) -> Block:
        """Return the rows for a noise without memory; those of another level or sizes are multiples, and cached."""
        if not any(known.spread is noise.spread and known.tail is noise.tail for known, _ in self._independent):
            plain = replace(self, size=np.ones(len(self.own)))
            self._independent[:] = [(noise, plain._with_further(self.bare.independent(noise), noise))]
        ((known, block),) = self._independent
        return block.louder(noise.sigma / known.sigma).sized(self.size)

    def _with_further(self, bare: Block, noise: Noise) -> Block:
        k = len(self.further)
        size = self.size.copy()
        size[k:] *= bare.size
        if not k:
            return replace(bare, size=size, bare=bare)
        lasting = np.concatenate((noise.white(self.further), bare.lasting))
        return Block(lasting, bare.target, self.own, bare.brief, size, bare.level, bare)
