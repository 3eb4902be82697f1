"""Symmetric positive definite block tridiagonal matrices: what couples each stretch of time to its neighbours only.

    A = [[D_0, B_0'], [B_0, D_1, B_1'], ...] = L L',   cost O(n_blocks b^3)

Differentiable. SciPy has banded solvers, but neither their derivative nor the blocks of the inverse.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True)
class BlockCholesky:
    """The factor L of A: per block row its diagonal block (b, b), lower triangular, and the block left of it."""

    diagonal: tuple[Tensor, ...]
    below: tuple[Tensor, ...]

    @classmethod
    def of(cls, diagonal: Tensor, below: Tensor) -> BlockCholesky:
        """Factor the matrix with blocks ``diagonal`` (n_blocks, b, b) and ``below`` them (n_blocks - 1, b, b).

        Raises:
            torch.linalg.LinAlgError: the matrix is not positive definite.
        """
        factors, couplings = [torch.linalg.cholesky(diagonal[0])], []
        for D, B in zip(diagonal[1:], below, strict=True):
            couplings.append(torch.linalg.solve_triangular(factors[-1], B.mT, upper=False).mT)
            factors.append(torch.linalg.cholesky(D - couplings[-1] @ couplings[-1].mT))
        return cls(tuple(factors), tuple(couplings))

    def half_solve(self, right: Tensor) -> Tensor:
        """Return L^-1 R of R (n_blocks, b, k)."""
        found: list[Tensor] = []
        for k, (L, r) in enumerate(zip(self.diagonal, right, strict=True)):
            known = r - self.below[k - 1] @ found[-1] if k else r
            found.append(torch.linalg.solve_triangular(L, known, upper=False))
        return torch.stack(found)

    def back_solve(self, right: Tensor) -> Tensor:
        """Return L'^-1 R of R (n_blocks, b, k)."""
        found: list[Tensor] = []
        last = len(self.diagonal) - 1
        for k in range(last, -1, -1):
            known = right[k] - self.below[k].mT @ found[-1] if k < last else right[k]
            found.append(torch.linalg.solve_triangular(self.diagonal[k].mT, known, upper=True))
        return torch.stack(found[::-1])

    def solve(self, right: Tensor) -> Tensor:
        """Return A^-1 R of R (n_blocks, b, k)."""
        return self.back_solve(self.half_solve(right))

    def logdet(self) -> Tensor:
        """Return log det A."""
        return 2.0 * torch.stack([L.diagonal().log().sum() for L in self.diagonal]).sum()

    def inverse_windows(self) -> Tensor:
        """Return the blocks of A^-1 that two neighbours share, (n_blocks - 1, 2 b, 2 b), by Takahashi's recursion."""
        corner = torch.cholesky_inverse(self.diagonal[-1])
        windows: list[Tensor] = []
        for L, B in zip(self.diagonal[-2::-1], self.below[::-1], strict=True):
            gain = torch.linalg.solve_triangular(L, B, upper=False, left=False)
            off = -corner @ gain
            above = torch.cholesky_inverse(L) - gain.mT @ off
            windows.append(torch.cat((torch.cat((above, off.mT), 1), torch.cat((off, corner), 1))))
            corner = above
        return torch.stack(windows[::-1])


def fold(windows: Tensor | Sequence[Tensor]) -> tuple[Tensor, Tensor]:
    """Sum overlapping windows (n - 1, 2 b, 2 b) into the blocks (n, b, b) and those below them (n - 1, b, b)."""
    stacked = windows if isinstance(windows, Tensor) else torch.stack(tuple(windows))
    b = stacked.shape[-1] // 2
    empty = stacked.new_zeros(1, b, b)
    diagonal = torch.cat((stacked[:, :b, :b], empty)) + torch.cat((empty, stacked[:, b:, b:]))
    return diagonal, stacked[:, b:, :b]


def fold_rows(windows: Tensor) -> Tensor:
    """Sum overlapping windows (n - 1, 2 b, k) into block rows (n, b, k)."""
    b = windows.shape[-2] // 2
    empty = windows.new_zeros(1, b, windows.shape[-1])
    return torch.cat((windows[:, :b], empty)) + torch.cat((empty, windows[:, b:]))
