"""Whitened rows of one joint, and their products."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from torchrbd.likelihood.brief import Brief


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
class Block:
    """Whitened rows of one joint: X (P_j, m), y (m,), and the coefficients ``own`` (P_j,) of its columns.

    Columns are multiples ``size`` (P_j,) of base columns that several blocks may share: ``lasting`` (L, m), then sparse
    ``brief`` ones (S, m), if any. The last ones may be those of another block, ``bare``, with other sizes.
    """

    lasting: np.ndarray
    y: np.ndarray
    own: np.ndarray
    brief: Brief | None = None
    size: np.ndarray | float = 1.0
    bare: Block | None = None
    _gram: list[np.ndarray] = field(default_factory=list, repr=False)

    @property
    def X(self) -> np.ndarray:
        """All rows, (P_j, m), computed anew."""
        return dense(self.size, self.lasting, self.brief)

    @cached_property
    def gram(self) -> np.ndarray:
        """X X', (P_j, P_j)."""
        size = np.broadcast_to(self.size, len(self.own))
        return self._products * np.outer(size, size)

    @property
    def _products(self) -> np.ndarray:
        """Products of the base columns, (P_j, P_j)."""
        if not self._gram:
            self._gram.append(self._multiplied())
        return self._gram[0]

    def _multiplied(self) -> np.ndarray:
        if self.bare is not None:
            first = len(self.own) - len(self.bare.own)
            own = self.lasting[:first]
            cross = replace(self, size=1.0).times(own.T)
            return _bordered(cross[:first], cross[first:], self.bare._products)
        own = self.lasting @ self.lasting.T
        if self.brief is None:
            return own
        return _bordered(own, self.brief.times(self.lasting.T), self.brief.products)

    def of_rows(self, rows: np.ndarray) -> np.ndarray:
        """Return some of the rows, by their numbers (...), as (P_j, ...)."""
        found = self.lasting[:, rows]
        found = found if self.brief is None else np.concatenate((found, self.brief.of_rows(rows)))
        return (found.T * self.size).T

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

    def some(self, kept: np.ndarray, own: np.ndarray) -> Block:
        """Return some of the columns, kept (P_j,) bool, renumbered by ``own`` of all (P_j,)."""
        if kept.all():
            return replace(self, own=own)
        first, size = len(self.lasting), np.broadcast_to(self.size, len(kept))[kept]
        brief = None if self.brief is None else self.brief.some(kept[first:])
        return Block(self.lasting[kept[:first]], self.y, own[kept], brief, size)

    def sized(self, by: np.ndarray | float) -> Block:
        """Return the same rows with their columns multiplied by (P_j,)."""
        return replace(self, size=self.size * by)

    def louder(self, part: float) -> Block:
        """Return the same rows with their noise multiplied by ``part``."""
        if part == 1.0:
            return self
        bare = None if self.bare is None else self.bare.louder(part)
        return replace(self, y=self.y / part, size=self.size / part, bare=bare)


def _bordered(first: np.ndarray, cross: np.ndarray, last: np.ndarray) -> np.ndarray:
    """Return the block matrix [first cross'; cross last]."""
    k = len(first)
    found = np.empty((k + len(last),) * 2)
    found[:k, :k], found[k:, k:] = first, last
    found[k:, :k], found[:k, k:] = cross, cross.T
    return found
