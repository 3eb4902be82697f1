"""Second moments of regression rows, block by block: all that the regressions of this folder read of the data.

A_b = sum over the rows of block b of  a a',   a = [x, y]
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch import Tensor

from torchrbd.errors import InputError


@dataclass(frozen=True)
class Moments:
    """Moments of N rows [x, y] in B blocks. There is no intercept: centre the data, or add a column of ones.

    Attributes:
        blocks: (B, d + 1, d + 1) sums of a a'; the last row and column belong to y.
        count: (B,) rows of each block, or independent samples where rows are correlated.
    """

    blocks: Tensor
    count: Tensor

    @classmethod
    def of(cls, X: Tensor | ArrayLike | Moments, y: Tensor | ArrayLike | None = None) -> Moments:
        """Return X if it is moments, otherwise those of the rows X (N, d) and y (N,).

        Raises:
            InputError: as ``from_data``; y missing, or given although moments hold it.
        """
        if isinstance(X, Moments):
            if y is not None:
                raise InputError("y is given with moments, which hold it already; give moments alone")
            return X
        if y is None:
            raise InputError("y is missing: give inputs X (N, d) and outputs y (N,), or moments alone")
        return cls.from_data(X, y)

    @classmethod
    def from_data(cls, X: Tensor | ArrayLike, y: Tensor | ArrayLike, n_blocks: int = 10) -> Moments:
        """Take the moments of X (N, d) and y (N,) in blocks of consecutive rows.

        Raises:
            InputError: shapes that do not fit, no rows, or values that are no numbers or not finite.
        """
        X, y = as_float64(X, "X"), as_float64(y, "y")
        if X.dim() != 2 or y.shape != X.shape[:1] or not len(X):
            raise InputError(
                f"regression rows: expected X (N, d) and y (N,) with N at least 1, "
                f"got {tuple(X.shape)} and {tuple(y.shape)}"
            )
        rows = torch.cat((X, y.unsqueeze(1)), 1)
        if not bool(rows.isfinite().all()):
            bad = int(torch.nonzero(~rows.isfinite().all(1))[0])
            raise InputError(f"regression rows: row {bad} has nan or inf; remove such rows")
        parts = rows.tensor_split(min(n_blocks, len(rows)))
        return cls(torch.stack([a.T @ a for a in parts]), torch.tensor([float(len(a)) for a in parts]).double())

    def select(self, keep: Tensor) -> Moments:
        """Return the blocks that ``keep`` (bool, (B,)) marks."""
        return Moments(self.blocks[keep], self.count[keep])

    def transform(self, W: Tensor) -> Moments:
        """Return the moments of the rows [W x, y], W (m, d)."""
        T = torch.block_diag(W, W.new_ones(1, 1))
        return Moments(T @ self.blocks @ T.T, self.count)

    def error(self, b: Tensor) -> Tensor:
        """Return the mean squared error of coefficients on these rows, less that of none.

            b'X'X b / N - 2 b'X'y / N = mean (y - x'b)^2 - mean y^2

        Args:
            b: (d,), or (d, K) for K candidates.

        Returns:
            () or (K,).
        """
        return ((self.xx @ b) * b).sum(0) - 2.0 * (self.xy @ b)

    @property
    def total(self) -> Tensor:
        """Moments of all rows together, (d + 1, d + 1)."""
        return self.blocks.sum(0)

    @property
    def n(self) -> float:
        """Number of rows."""
        return float(self.count.sum())

    @property
    def d(self) -> int:
        """Number of inputs."""
        return self.blocks.shape[-1] - 1

    @property
    def xx(self) -> Tensor:
        """X'X / N, (d, d)."""
        return self.total[:-1, :-1] / self.n

    @property
    def xy(self) -> Tensor:
        """X'y / N, (d,)."""
        return self.total[:-1, -1] / self.n

    @property
    def yy(self) -> Tensor:
        """y'y / N."""
        return self.total[-1, -1] / self.n


def as_float64(values: Tensor | ArrayLike, name: str) -> Tensor:
    """Return numbers as a float64 tensor, a tensor's own device and gradient kept.

    Raises:
        InputError: the argument called ``name`` is no array of numbers.
    """
    if isinstance(values, Tensor):
        return values.to(torch.float64)
    try:
        return torch.from_numpy(np.array(values, dtype=np.float64))
    except (TypeError, ValueError):
        raise InputError(f"{name}: expected an array of numbers, got {type(values).__name__}") from None
