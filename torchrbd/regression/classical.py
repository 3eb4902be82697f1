"""The rivals that need no tuning: least squares, truncated SVD, total least squares and stepwise selection."""

from __future__ import annotations

import math

import torch
from numpy.typing import ArrayLike
from torch import Tensor

from torchrbd.errors import OptionError
from torchrbd.regression.base import Regression
from torchrbd.regression.moments import Moments, as_float64

# Moments hold squares: singular values below the root of the rounding error cannot be distinguished from zero.
ROUNDING = 1e-6


class OrdinaryLeastSquares(Regression):
    """Ordinary least squares; the shortest solution, in normalised columns, where X lacks rank."""

    name = "ols"

    def _coefficients(self, moments: Moments) -> Tensor:
        C, c, scale = normalised(moments)
        return _truncated(C, c, ROUNDING) / scale


class TruncatedSVD(Regression):
    """Pseudo-inverse without the directions of small singular values.

        b = sum_{s_k > tolerance s_1} v_k s_k^-1 u_k'y

    Args:
        tolerance: smallest singular value of the normalised columns that counts, relative to the largest.
    """

    name = "svd"

    def __init__(self, tolerance: float = 1e-3) -> None:
        if not 0.0 < tolerance < 1.0:
            raise OptionError(f"tolerance: expected a number between 0 and 1, got {tolerance}; 1e-3 is usual")
        self.tolerance = tolerance

    def _coefficients(self, moments: Moments) -> Tensor:
        C, c, scale = normalised(moments)
        return _truncated(C, c, max(self.tolerance, ROUNDING)) / scale


class TotalLeastSquares(Regression):
    """Total least squares (orthogonal regression): inputs and output are equally noisy in the units of ``noise``.

        minimise  |[X - X0, y - X0 b] W^-1|^2  over X0 and b,   W = diag(sqrt(noise))

    Without ``noise`` all columns and y are scaled to unit mean square. Where X lacks rank, all directions beyond its
    rank count as noise and b is the shortest solution.

    Args:
        noise: (d + 1,) noise variances of the inputs and of y, up to a common factor.

    Source: Golub, Van Loan, "An analysis of the total least squares problem" (1980); for the rank-deficient case
    Fierro, Golub, Hansen, O'Leary, "Regularization by truncated total least squares" (1997), eq. (6).
    """

    name = "tls"

    def __init__(self, noise: Tensor | ArrayLike | None = None) -> None:
        self.noise = noise

    def _coefficients(self, moments: Moments) -> Tensor:
        A = moments.total / moments.n
        scale = nonzero_root(A.diagonal()) if self.noise is None else _noise_scale(self.noise, moments.d)
        A = A / (scale.unsqueeze(1) * scale)
        rank = _rank(torch.linalg.eigvalsh(A[:-1, :-1]), ROUNDING)
        V = torch.linalg.eigh(A).eigenvectors[:, : moments.d + 1 - rank]
        v = V[-1]
        return -(V[:-1] @ v) / (v @ v).clamp_min(1e-300) * scale[-1] / scale[:-1]


class Stepwise(Regression):
    """Forward and backward selection of columns by the Bayesian information criterion, then least squares on them.

        BIC = N log(RSS / N) + k log(N)

    Each step adds or removes the one column that lowers the criterion most. Columns that the chosen ones explain
    up to rounding are never added.

    Args:
        always: number of leading columns that are in from the start and stay.

    Source: Efroymson, "Multiple regression analysis" (1960), with the sweep operator; Schwarz (1978) for BIC.
    """

    name = "stepwise"

    def __init__(self, always: int = 0) -> None:
        self.always = always

    def _coefficients(self, moments: Moments) -> Tensor:
        C, c, scale = normalised(moments)
        swept = torch.zeros(moments.d + 1, moments.d + 1, dtype=torch.float64)
        swept[:-1, :-1], swept[:-1, -1], swept[-1, :-1], swept[-1, -1] = C, c, c, moments.yy
        least = max(ROUNDING * float(moments.yy), 1e-300)
        chosen = torch.zeros(moments.d, dtype=torch.bool)
        for column in range(self.always):
            if float(swept[column, column]) > ROUNDING**1.5:
                swept = _sweep(swept, column)
                chosen[column] = True
        free = torch.arange(moments.d) >= self.always
        penalty = math.log(moments.n) / moments.n
        # The criterion falls at every step, so that the loop ends; the bound is for what rounding does to perfect fits.
        for _ in range(4 * moments.d):
            pivot, slope, rss = swept.diagonal()[:-1], swept[:-1, -1], float(swept[-1, -1])
            usable = free & (chosen | (pivot > ROUNDING**1.5))
            # Swept pivots are negative: the same quotient is what a column would take from RSS or give back.
            after = torch.where(usable, rss - slope**2 / torch.where(usable, pivot, 1.0), rss).clamp_min(least)
            change = (after / max(rss, least)).log() + penalty * torch.where(chosen, -1.0, 1.0)
            change[~usable] = 0.0
            best = int(change.argmin())
            if float(change[best]) > -1e-12 or (not chosen[best] and int(chosen.sum()) >= moments.n - 1):
                break
            swept = _sweep(swept, best)
            chosen[best] = ~chosen[best]
        b = torch.zeros(moments.d, dtype=torch.float64)
        b[chosen] = swept[:-1, -1][chosen]
        return b / scale


def normalised(moments: Moments) -> tuple[Tensor, Tensor, Tensor]:
    """Return X'X / N (d, d) and X'y / N (d,) of columns of unit mean square, and their scale (d,), 1 for zero ones."""
    scale = nonzero_root(moments.xx.diagonal())
    return moments.xx / (scale.unsqueeze(1) * scale), moments.xy / scale, scale


def nonzero_root(square: Tensor) -> Tensor:
    """Return the square root, and 1 for what is not positive: a scale that can be divided by."""
    return torch.where(square > 0.0, square, 1.0).sqrt()


def _noise_scale(noise: Tensor | ArrayLike, d: int) -> Tensor:
    """Return the standard deviations (d + 1,) that total least squares divides by."""
    noise = as_float64(noise, "noise")
    if noise.shape != (d + 1,) or not bool((noise > 0.0).all()):
        raise OptionError(
            f"noise: expected {d + 1} positive variances, of {d} inputs and of y, got shape {tuple(noise.shape)}; "
            "give an input without noise a small variance"
        )
    return noise.sqrt()


def _truncated(C: Tensor, c: Tensor, tolerance: float) -> Tensor:
    """Return C^+ c without the singular values of X below ``tolerance`` of the largest."""
    value, vector = torch.linalg.eigh(C)
    kept = vector[:, len(value) - _rank(value, tolerance) :]
    return kept @ ((kept.T @ c) / value[len(value) - kept.shape[1] :])


def _rank(eigenvalues: Tensor, tolerance: float) -> int:
    return int((eigenvalues > max(tolerance**2, ROUNDING**2) * float(eigenvalues[-1].clamp_min(1e-300))).sum())


def _sweep(A: Tensor, k: int) -> Tensor:
    """Sweep column k in, or out again: after it, the pivots chosen hold -(X'X)^-1 and their column of y holds b."""
    pivot, column = A[k, k].clone(), A[:, k].clone()
    A = A - column.unsqueeze(1) * column / pivot
    A[k], A[:, k] = column / pivot.abs(), column / pivot.abs()
    A[k, k] = -1.0 / pivot
    return A
