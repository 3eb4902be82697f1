"""Square roots of second moments: what least squares needs of rows without squaring their condition number.

    R_k = qr([R_k-1; rows_k]),   R'R = sum of a a',   a = [x, y]

Normal equations lose twice the digits that the rows' condition number takes, and from 1e8 on all of them; R, which is
made by orthogonal transformations alone, loses them once. Roots of pieces add as their rows would: by stacking.

Source: Golub, Van Loan, "Matrix Computations", 4th ed., sec. 5.3 and 6.5; Demmel, Grigori, Hoemmen, Langou,
"Communication-optimal parallel and sequential QR and LU factorizations", SIAM J. Sci. Comput. 2012 (TSQR).
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True)
class SquareRoot:
    """The triangular factor R of rows [x, y].

    Attributes:
        factor: R (d + 1, d + 1), upper triangular; the last column belongs to y.
    """

    factor: Tensor

    @classmethod
    def empty(cls, width: int) -> SquareRoot:
        """Return that of no rows of ``width`` numbers."""
        return cls(torch.zeros(width, width, dtype=torch.float64))

    def with_rows(self, rows: Tensor) -> SquareRoot:
        """Return the root of these rows and more, (N, d + 1)."""
        return SquareRoot(torch.linalg.qr(torch.cat((self.factor, rows)), mode="r")[1])

    def __add__(self, other: SquareRoot) -> SquareRoot:
        return self.with_rows(other.factor)

    def solve(self) -> tuple[Tensor, Tensor]:
        """Return the least squares solution (d,), and a root S (d, d) of its covariance S S' at unit noise.

        Columns are scaled to unit length first, so that units do not make the condition worse. Directions without
        information, to rounding, have the least norm in the scaled columns and no part in S.
        """
        R, y = self.factor[:-1, :-1], self.factor[:-1, -1]
        length = R.norm(dim=0)
        length = torch.where(length > 0, length, torch.ones_like(length))
        U, size, V = torch.linalg.svd(R / length)
        nonzero = size > size[0] * len(R) * torch.finfo(R.dtype).eps
        inverse = torch.where(nonzero, size.reciprocal(), torch.zeros_like(size))
        root = V.T * inverse / length.unsqueeze(1)
        return root @ (U.T @ y), root
