"""Cubic splines on uniform knots, aligned with the band-limited torque.

    q(t) = sum_i c_i beta((t - t_0) / h - i + 1),   beta the cubic B-spline of support 4

Torque is sampled every dt_out, about 0.4 / f_c. One knot to a torque sample bends a motion near f_c (5 Hz at f_c = 7
Hz by some per cent, all of which would go into the parameters); more knots pass it, and more noise with it. The
dynamics are evaluated ``substeps`` times as often as torque is sampled. Otherwise their response to a motion near f_c
would be aliased into the band. The torque filter reaches over ``reach`` of these steps to each side.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

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
        output_step: time between torque samples, dt_out [s].
        per_output: knots to a torque sample.
        substeps: evaluations of the dynamics to a torque sample.
        outputs: number of torque samples.
        kernel: (2 reach + 1,) torque filter, sampled at the evaluations; reach is a multiple of ``substeps``.
    """

    start: float
    output_step: float
    per_output: int
    substeps: int
    outputs: int
    kernel: Tensor

    @property
    def spacing(self) -> float:
        """Time between knots, h [s]."""
        return self.output_step / self.per_output

    @property
    def reach(self) -> int:
        """Reach of the torque filter, in evaluations."""
        return len(self.kernel) // 2

    @property
    def step(self) -> float:
        """Time between evaluations of the dynamics [s]."""
        return self.output_step / self.substeps

    @property
    def width(self) -> int:
        """Coefficients that one torque sample depends on: torque sample o on those from ``per_output`` o."""
        return 2 * self.per_output * (self.reach // self.substeps) + _DEGREE

    @property
    def outputs_per_block(self) -> int:
        """Torque samples whose coefficients begin in the same block, so that they end in the next one."""
        return -(-self.width // self.per_output)

    @property
    def block(self) -> int:
        """Coefficients of one joint in a block."""
        return self.per_output * self.outputs_per_block

    @property
    def n_coefficients(self) -> int:
        """Coefficients of one joint."""
        return self.per_output * (self.outputs - 1) + self.width

    @property
    def first_output(self) -> float:
        """Time of the first torque sample [s]."""
        return self.start + self.reach * self.step

    @property
    def end(self) -> float:
        """Time of the last knot [s]."""
        return self.start + (self.n_coefficients - _DEGREE) * self.spacing

    @property
    def instants(self) -> np.ndarray:
        """Times at which the dynamics are evaluated [s]."""
        return self.start + self.step * np.arange(self.substeps * (self.outputs - 1) + 2 * self.reach + 1)

    @property
    def basis(self) -> Tensor:
        """Value, first and second derivative of the basis at the instants (3, N, n_coefficients)."""
        return _basis(self.n_coefficients, self.spacing, len(self.instants), self.step)

    @property
    def filtered_basis(self) -> Tensor:
        """The basis that one torque sample sees, times the filter: (3 (2 reach + 1), width)."""
        window = self.basis[:, : 2 * self.reach + 1, : self.width]
        return (self.kernel[:, None] * window).flatten(0, 1)

    def sample_basis(self, t: np.ndarray):
        """Return the basis at times t as a sparse matrix (N, n_coefficients)."""
        knots = self.start + _knots(self.n_coefficients, self.spacing)
        return BSpline.design_matrix(np.clip(t, self.start, self.end), knots, _DEGREE)

    def states(self, coefficients: Tensor, t: np.ndarray) -> tuple[Tensor, Tensor, Tensor]:
        """Return q, qd, qdd, each (n, N), of coefficients (n_coefficients, n) at times t."""
        spline = BSpline(_knots(self.n_coefficients, self.spacing), coefficients.numpy(), _DEGREE)
        q, qd, qdd = (torch.from_numpy(spline(t - self.start, nu=order).T.copy()) for order in range(3))
        return q, qd, qdd


def _knots(n_coefficients: int, spacing: float) -> np.ndarray:
    return spacing * np.arange(-_DEGREE, n_coefficients + 1)


@lru_cache(maxsize=4)
def _basis(n_coefficients: int, spacing: float, instants: int, step: float) -> Tensor:
    spline = BSpline(_knots(n_coefficients, spacing), np.eye(n_coefficients), _DEGREE)
    return torch.from_numpy(np.stack([spline(step * np.arange(instants), nu=order) for order in range(3)]))
