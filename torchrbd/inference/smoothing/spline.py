"""Cubic splines on uniform knots, aligned with the band-limited torque: one knot at each of its samples.

    q(t) = sum_i c_i beta((t - t_0) / h - i + 1),   beta the cubic B-spline of support 4

The knot spacing h = dt_out, about 0.4 / f_c, passes motion up to 1.25 f_c. The torque filter reaches over ``half``
half knots to each side, so that torque sample o depends on the ``width = half + 3`` coefficients from o on.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from scipy.interpolate import BSpline
from torch import Tensor

_DEGREE = 3


@dataclass(frozen=True)
class Grid:
    """Where the knots of a stretch lie.

    Attributes:
        start: time of the first knot [s].
        spacing: h [s].
        outputs: number of torque samples.
        kernel: (2 half + 1,) torque filter, sampled at half knots; half is even.
    """

    start: float
    spacing: float
    outputs: int
    kernel: Tensor

    @property
    def half(self) -> int:
        """Reach of the torque filter in half knots."""
        return len(self.kernel) // 2

    @property
    def width(self) -> int:
        """Coefficients that one torque sample depends on."""
        return self.half + _DEGREE

    @property
    def n_coefficients(self) -> int:
        """Coefficients of one joint."""
        return self.outputs - 1 + self.width

    @property
    def first_output(self) -> float:
        """Time of the first torque sample [s]."""
        return self.start + 0.5 * self.half * self.spacing

    @property
    def end(self) -> float:
        """Time of the last knot [s]."""
        return self.start + (self.n_coefficients - _DEGREE) * self.spacing

    @property
    def half_knots(self) -> np.ndarray:
        """Times of the knots and the middles between them, where the dynamics are evaluated [s]."""
        return self.start + 0.5 * self.spacing * np.arange(2 * (self.n_coefficients - _DEGREE) + 1)

    def basis(self, t: np.ndarray) -> Tensor:
        """Return value, first and second derivative of the basis (3, N, n_coefficients) at times within the grid."""
        spline = BSpline(self._knots, np.eye(self.n_coefficients), _DEGREE, extrapolate=True)
        return torch.from_numpy(np.stack([spline(t, nu=order) for order in range(3)]))

    @cached_property
    def half_knot_basis(self) -> Tensor:
        """The basis at the half knots."""
        return self.basis(self.half_knots)

    @cached_property
    def filtered_basis(self) -> Tensor:
        """The basis that one torque sample sees, times the filter: (3 (2 half + 1), width)."""
        window = self.half_knot_basis[:, : 2 * self.half + 1, : self.width]
        return (self.kernel[:, None] * window).flatten(0, 1)

    def sample_basis(self, t: np.ndarray):
        """Return the basis as a sparse matrix (N, n_coefficients)."""
        return BSpline.design_matrix(np.clip(t, self.start, self.end), self._knots, _DEGREE)

    def states(self, coefficients: Tensor, t: np.ndarray) -> tuple[Tensor, Tensor, Tensor]:
        """Return q, qd, qdd, each (n, N), of coefficients (n_coefficients, n) at times t."""
        spline = BSpline(self._knots, coefficients.detach().numpy(), _DEGREE, extrapolate=True)
        q, qd, qdd = (torch.from_numpy(spline(t, nu=order).T.copy()) for order in range(3))
        return q, qd, qdd

    @property
    def _knots(self) -> np.ndarray:
        return self.start + self.spacing * np.arange(-_DEGREE, self.n_coefficients + 1)
