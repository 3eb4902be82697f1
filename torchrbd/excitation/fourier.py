"""Motions as finite Fourier series that begin and end at rest.

    q_j(t) = c_j + sum_l a_jl sin(l w t) + b_jl cos(l w t),   l = 1 ... H,   w = 2 pi / T

A motion of one base frequency for all joints repeats after T. It stands still there, without acceleration, if

    sum_l l a_jl = 0   and   sum_l l^2 b_jl = 0

so that a robot that waits at q(0) can enter and leave it at the end of any period.

Source: Swevers et al., "Optimal robot excitation and identification", IEEE Trans. Robotics and Automation 1997, for
    the series; the two conditions are our own.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor


def null_space(row: Tensor) -> Tensor:
    """Return an orthonormal basis (H, H - 1) of what is orthogonal to a row (H,)."""
    return torch.linalg.svd(row.unsqueeze(0)).Vh[1:].T


@dataclass(frozen=True)
class Basis:
    """The free coefficients of one joint: its centre, then velocities that keep both conditions.

    Attributes:
        period_s: T.
        harmonics: H, at least 2.
    """

    period_s: float
    harmonics: int

    @property
    def n(self) -> int:
        """Number of free coefficients of a joint, 2 H - 1."""
        return 2 * self.harmonics - 1

    @cached_property
    def series(self) -> Tensor:
        """What centre and coefficients (c, a_1 ... a_H, b_1 ... b_H) are of the free ones, (2 H + 1, 2 H - 1)."""
        order = torch.arange(1, self.harmonics + 1, dtype=torch.float64)
        speed = (order * 2.0 * math.pi / self.period_s).reciprocal().unsqueeze(1)
        centre = torch.ones(1, 1, dtype=torch.float64)
        return torch.block_diag(centre, speed * null_space(torch.ones_like(order)), speed * null_space(order))

    def at(self, t: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return what q, qd and qdd at times t (N,) [s] are of the free coefficients, (N, 2 H - 1) each."""
        rate = torch.arange(1, self.harmonics + 1, dtype=torch.float64) * 2.0 * math.pi / self.period_s
        turn = t.unsqueeze(1) * rate
        s, c, one = turn.sin(), turn.cos(), torch.ones_like(t).unsqueeze(1)
        q = torch.cat((one, s, c), 1)
        qd = torch.cat((0.0 * one, rate * c, -rate * s), 1)
        qdd = torch.cat((0.0 * one, -(rate**2) * s, -(rate**2) * c), 1)
        return q @ self.series, qd @ self.series, qdd @ self.series


@dataclass(frozen=True)
class FourierMotion:
    """A motion of n joints.

    Attributes:
        basis: period and harmonics.
        free: (n, 2 H - 1) the free coefficients.
    """

    basis: Basis
    free: Tensor

    @property
    def period_s(self) -> float:
        """T [s]."""
        return self.basis.period_s

    @property
    def centre(self) -> Tensor:
        """c (n,) [rad or m]."""
        return self.free[:, 0]

    @property
    def sine(self) -> Tensor:
        """a (n, H) [rad or m]."""
        return (self.free @ self.basis.series.T)[:, 1 : 1 + self.basis.harmonics]

    @property
    def cosine(self) -> Tensor:
        """b (n, H) [rad or m]."""
        return (self.free @ self.basis.series.T)[:, 1 + self.basis.harmonics :]

    def states(self, t: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return q, qd, qdd (N, n) at times t (N,) [s]."""
        q, qd, qdd = (part @ self.free.T for part in self.basis.at(t))
        return q, qd, qdd

    @property
    def start(self) -> Tensor:
        """Where every period begins and ends, (n,) [rad or m]."""
        return self.states(torch.zeros(1, dtype=torch.float64))[0][0]

    def shrunk(self, part: float) -> FourierMotion:
        """Return the motion with smaller strokes around the same centre."""
        free = self.free.clone()
        free[:, 1:] *= part
        return FourierMotion(self.basis, free)
