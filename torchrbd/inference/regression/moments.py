"""Second moments of regression rows, block by block: all that the regressions of this folder read of the data.

A_b = sum over the rows of block b of  a a',   a = [x, y]
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
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
    def from_data(cls, X: Tensor, y: Tensor, n_blocks: int = 10) -> Moments:
        """Take the moments of X (N, d) and y (N,) in blocks of consecutive rows.

        Raises:
            InputError: shapes that do not fit, no rows, or values that are not finite.
        """
        if X.dim() != 2 or y.shape != X.shape[:1] or not len(X):
            raise InputError(
                f"regression rows: expected X (N, d) and y (N,) with N at least 1, "
                f"got {tuple(X.shape)} and {tuple(y.shape)}"
            )
        rows = torch.cat((X, y.unsqueeze(1)), 1).to(torch.float64)
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
