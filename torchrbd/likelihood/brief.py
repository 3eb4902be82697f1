"""Sparse columns that are nonzero only at a joint's rests and reversals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array


@dataclass(frozen=True, eq=False)
class Brief:
    """Sparse columns (S, m): a matrix x with ``rows`` rows, of which three to nine percent is nonzero."""

    x: csr_array
    rows: int

    @staticmethod
    def of(A: np.ndarray) -> Brief:
        """Make sparse columns of dense ones (S, m)."""
        return Brief(csr_array(A), A.shape[1])

    @property
    def dense(self) -> np.ndarray:
        """The dense matrix, (S, m)."""
        return self.x.toarray()

    @property
    def products(self) -> np.ndarray:
        """X X', (S, S)."""
        return (self.x @ self.x.T).toarray()

    def __len__(self) -> int:
        return len(self.x.indptr) - 1

    def some(self, kept: np.ndarray) -> Brief:
        """Return some of the columns, kept (S,) bool."""
        return Brief(self.x[np.flatnonzero(kept)], self.rows)

    def among(self, rows: np.ndarray) -> Brief:
        """Return the columns at some of the rows, (m,) bool."""
        return Brief(self.x[:, np.flatnonzero(rows)], int(rows.sum()))

    def of_rows(self, rows: np.ndarray) -> np.ndarray:
        """Return the columns at some rows (...), (S, ...)."""
        return self.x[:, rows.ravel()].toarray().reshape(len(self), *rows.shape)

    def scaled(self, by: np.ndarray) -> Brief:
        """Return the columns multiplied by (m,)."""
        x = self.x
        return Brief(csr_array((x.data * by[x.indices], x.indices, x.indptr), shape=x.shape), self.rows)

    def times(self, C: np.ndarray) -> np.ndarray:
        """Return X C for C (m, ...), (S, ...)."""
        return self.x @ C

    def in_parts(self, C: np.ndarray, edges: np.ndarray) -> np.ndarray:
        """Return X C' for C (K, m) in each part of the rows between ascending edges (B + 1,), (B, S, K)."""
        S = len(self)
        part = np.searchsorted(edges, self.x.indices, side="right") - 1
        inside = (part >= 0) & (part < len(edges) - 1)
        at = (part * S + self._column)[inside], self.x.indices[inside]
        apart = csr_array((self.x.data[inside], at), shape=((len(edges) - 1) * S, self.rows))
        return (apart @ C.T).reshape(len(edges) - 1, S, len(C))

    def unpredicted(self, predictor: np.ndarray, index: np.ndarray) -> Brief:
        """Return the errors of a predictor (p,) of the columns at rows ``index`` (m',), from the rows before.

        Each column is filtered from its first to its last nonzero number, one after the other, with space between them
        for the filter's memory.
        """
        S, reach, held = len(self), len(predictor), np.diff(self.x.indptr)
        begins, ends = np.zeros(S, dtype=int), np.zeros(S, dtype=int)
        begins[held > 0] = np.minimum.reduceat(self.x.indices, self.x.indptr[:-1][held > 0])
        ends[held > 0] = np.maximum.reduceat(self.x.indices, self.x.indptr[:-1][held > 0]) + 1
        lengths = ends - begins + reach
        first = np.cumsum(lengths) - lengths
        row = np.arange(lengths.sum()) + np.repeat(begins - first, lengths)
        signal = np.zeros(len(row) + 1)
        signal[self.x.indices + (first - begins)[self._column]] = self.x.data
        left = np.convolve(signal, np.concatenate(([1.0], -predictor)))[: len(row)]
        number = np.full(self.rows + reach, -1)
        number[index] = np.arange(len(index))
        kept = (number[row] >= 0) & (left != 0.0)
        at = np.repeat(np.arange(S), lengths)[kept], number[row][kept]
        return Brief(csr_array((left[kept], at), shape=(S, len(index))), len(index))

    @property
    def _column(self) -> np.ndarray:
        """Column index of each number."""
        return np.repeat(np.arange(len(self)), np.diff(self.x.indptr))
