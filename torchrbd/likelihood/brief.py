"""Columns that a joint has at some moments alone, its rests and reversals: zero nearly everywhere."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class Brief:
    """Columns (S, m) that are zero but at some rows ``at`` (b,), where they are ``x`` (S, b).

    A dense matrix of these rows: a sparse one holds fewer numbers still, and takes longer for each product.
    """

    x: np.ndarray
    at: np.ndarray
    rows: int

    @staticmethod
    def of(A: np.ndarray) -> Brief:
        """Return columns (S, m)."""
        at = np.flatnonzero(A.any(axis=0))
        return Brief(A[:, at], at, A.shape[1])

    @property
    def dense(self) -> np.ndarray:
        """All of it, (S, m)."""
        found = np.zeros((len(self.x), self.rows))
        found[:, self.at] = self.x
        return found

    def __len__(self) -> int:
        return len(self.x)

    def some(self, kept: np.ndarray) -> Brief:
        """Return some of the columns, kept (S,) bool."""
        return Brief(self.x[kept], self.at, self.rows)

    def of_rows(self, rows: np.ndarray) -> np.ndarray:
        """Return the columns at some rows (...), (S, ...)."""
        if not len(self.at):
            return np.zeros((len(self.x), *rows.shape))
        place = np.minimum(np.searchsorted(self.at, rows), len(self.at) - 1)
        return self.x[:, place] * (self.at[place] == rows)

    def scaled(self, by: np.ndarray) -> Brief:
        """Return the columns times (m,)."""
        return Brief(self.x * by[self.at], self.at, self.rows)

    def times(self, C: np.ndarray) -> np.ndarray:
        """Return X C of C (m, ...), (S, ...)."""
        return self.x @ C[self.at]
