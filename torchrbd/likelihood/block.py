"""Whitened rows of one joint, and their moments.

A model with other noise levels or prior sizes has multiples of the same rows: their moments are computed once.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from torchrbd.likelihood.brief import Brief
from torchrbd.likelihood.root import Eliminated, eliminate


def along(z: np.ndarray, lasting: np.ndarray, brief: Brief | None) -> np.ndarray:
    """Return z X for coefficients z (..., P) and columns X (P, m); the last columns are sparse (``brief``), if any."""
    if brief is None:
        return z @ lasting
    return z[..., : len(lasting)] @ lasting + z[..., len(lasting) :] @ brief.x


def dense(size: np.ndarray | float, lasting: np.ndarray, brief: Brief | None) -> np.ndarray:
    """Return lasting and sparse columns as one matrix, (P, m), each times its size (P,)."""
    whole = lasting if brief is None else np.concatenate((lasting, brief.dense))
    return (whole.T * size).T


@dataclass(frozen=True)
class Moments:
    """Second moments of columns B (P, m) and a target t (m,): B B' (P, P), B t (P,) and t't."""

    products: np.ndarray
    scores: np.ndarray
    power: float

    def some(self, kept: np.ndarray) -> Moments:
        """Return those of some of the columns, kept (P,) bool."""
        return Moments(self.products[np.ix_(kept, kept)], self.scores[kept], self.power)


@dataclass(frozen=True)
class Block:
    """Whitened rows of one joint: X (P_j, m), y (m,), and the coefficients ``own`` (P_j,) of its columns.

    X and y are multiples, ``size`` (P_j,) and ``level``, of base columns and a target that several blocks may share:
    ``lasting`` (L, m), then sparse ``brief`` ones (S, m), if any. The last ones may be those of another block,
    ``bare``, with other sizes.
    """

    lasting: np.ndarray
    target: np.ndarray
    own: np.ndarray
    brief: Brief | None = None
    size: np.ndarray | float = 1.0
    level: float = 1.0
    bare: Block | None = None
    _moments: list[Moments] = field(default_factory=list, repr=False)
    _eliminated: list[tuple[np.ndarray, np.ndarray, np.ndarray, Eliminated]] = field(
        default_factory=list, init=False, repr=False
    )

    @property
    def X(self) -> np.ndarray:
        """All rows, (P_j, m), computed anew."""
        return dense(self.size, self.lasting, self.brief)

    @cached_property
    def y(self) -> np.ndarray:
        """The whitened target (m,)."""
        return self.target * self.level

    @cached_property
    def gram(self) -> np.ndarray:
        """X X', (P_j, P_j)."""
        size = np.broadcast_to(self.size, len(self.own))
        return self._base.products * np.outer(size, size)

    @cached_property
    def scores(self) -> np.ndarray:
        """X y, (P_j,)."""
        return self._base.scores * (self.level * self.size)

    @property
    def power(self) -> float:
        """y'y."""
        return self._base.power * self.level**2

    @property
    def _base(self) -> Moments:
        """Moments of the base columns and the target."""
        if not self._moments:
            self._moments.append(self._multiplied())
        return self._moments[0]

    def _multiplied(self) -> Moments:
        if self.bare is not None:
            known, first = self.bare._base, len(self.own) - len(self.bare.own)
            own = self.lasting[:first]
            cross = replace(self, size=1.0).times(own.T)
            products = _bordered(cross[:first], cross[first:], known.products)
            return Moments(products, np.concatenate((own @ self.target, known.scores)), known.power)
        own = self.lasting @ self.lasting.T
        if self.brief is not None:
            own = _bordered(own, self.brief.times(self.lasting.T), self.brief.products)
        return Moments(own, replace(self, size=1.0).times(self.target), float(self.target @ self.target))

    def eliminated(self, alone: np.ndarray, precision: np.ndarray) -> tuple[np.ndarray, Eliminated]:
        """Return the products of shared columns, and what eliminates all others; the last answer is remembered.

        Args:
            alone: (P_j,) bool, the columns whose coefficients only this block has.
            precision: (k,) of their prior.
        """
        known = self._eliminated[0][:2] if self._eliminated else ()
        if not known or not (np.array_equal(known[0], alone) and np.array_equal(known[1], precision)):
            own, shared = np.flatnonzero(alone), np.flatnonzero(~alone)
            found = eliminate(self.gram[np.ix_(own, own)], self.gram[np.ix_(own, shared)], precision)
            self._eliminated[:] = [(alone, precision, self.gram[np.ix_(shared, shared)], found)]
        return self._eliminated[0][2:]

    def of_rows(self, rows: np.ndarray) -> np.ndarray:
        """Return some of the rows, by their numbers (...), as (P_j, ...)."""
        found = self.lasting[:, rows]
        found = found if self.brief is None else np.concatenate((found, self.brief.of_rows(rows)))
        return (found.T * self.size).T

    def without(self, rows: np.ndarray) -> Block:
        """Return all rows but some, by their numbers (k,): moments are differences."""
        base, t, kept = replace(self, size=1.0).of_rows(rows), self.target[rows], np.ones(len(self.target), bool)
        kept[rows] = False
        whole, brief = self._base, self.brief
        left = Moments(whole.products - base @ base.T, whole.scores - base @ t, whole.power - float(t @ t))
        brief = None if brief is None else brief.among(kept)
        return Block(self.lasting[:, kept], self.target[kept], self.own, brief, self.size, self.level, None, [left])

    def times(self, C: np.ndarray) -> np.ndarray:
        """Return X C for C (m, ...)."""
        found = self.lasting @ C
        found = found if self.brief is None else np.concatenate((found, self.brief.times(C)))
        return (found.T * self.size).T

    def in_parts(self, C: np.ndarray, edges: np.ndarray) -> np.ndarray:
        """Return X C' for C (K, m) in each part of the rows between ascending edges (B + 1,), (B, P_j, K)."""
        found, first = np.zeros((len(edges) - 1, len(self.own), len(C))), len(self.lasting)
        for k, (begin, end) in enumerate(pairwise(edges)):
            np.matmul(self.lasting[:, begin:end], C[:, begin:end].T, out=found[k, :first])
        if self.brief is not None:
            found[:, first:] = self.brief.in_parts(C, edges)
        found *= np.broadcast_to(self.size, len(self.own))[:, None]
        return found

    def explained(self, z: np.ndarray) -> np.ndarray:
        """Return z X for coefficients z (..., P_j), (..., m)."""
        return along(z * self.size, self.lasting, self.brief)

    @cached_property
    def of_bare(self) -> Block:
        """The columns of its ``bare`` block alone, with their sizes here."""
        assert self.bare is not None
        first = len(self.own) - len(self.bare.own)
        return replace(self.bare, size=np.broadcast_to(self.size, len(self.own))[first:], bare=self.bare)

    def some(self, kept: np.ndarray, own: np.ndarray) -> Block:
        """Return some of the columns, kept (P_j,) bool, renumbered by ``own`` of all (P_j,)."""
        if kept.all():
            same = replace(self, own=own)
            same._eliminated[:] = self._eliminated
            return same
        first, size = len(self.lasting), np.broadcast_to(self.size, len(kept))[kept]
        bare = self.bare if self.bare is not None and kept[-len(self.bare.own) :].all() else None
        if bare is not None and kept.sum() == len(bare.own):
            return self.of_bare
        brief = self.brief if self.brief is None or kept[first:].all() else self.brief.some(kept[first:])
        known = [one.some(kept) for one in self._moments]
        return Block(self.lasting[kept[:first]], self.target, own[kept], brief, size, self.level, bare, known)

    def sized(self, by: np.ndarray | float) -> Block:
        """Return the same rows with their columns multiplied by (P_j,)."""
        if np.all(by == 1.0):
            return self
        return replace(self, size=self.size * by)

    def louder(self, part: float) -> Block:
        """Return the same rows with their noise multiplied by ``part``."""
        if part == 1.0:
            return self
        bare = None if self.bare is None else self.bare.louder(part)
        return replace(self, level=self.level / part, size=self.size / part, bare=bare)


def _bordered(first: np.ndarray, cross: np.ndarray, last: np.ndarray) -> np.ndarray:
    """Return the block matrix [first cross'; cross last]."""
    k = len(first)
    found = np.empty((k + len(last),) * 2)
    found[:k, :k], found[k:, k:] = first, last
    found[k:, :k], found[:k, k:] = cross, cross.T
    return found
