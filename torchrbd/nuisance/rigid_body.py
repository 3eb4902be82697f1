"""Rigid body: tau_j = Y_j pi, around the URDF.

    pi = mean + S z / sqrt(kappa)

S is in the metric of pseudo-inertias, so that mass, centre and inertia of a body vary together as those of matter do.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from copy import copy

import numpy as np
import torch
from torch import Tensor

from torchrbd.dataset.rows import Rows
from torchrbd.nuisance.component import Along, Component, Learnt


class RigidBody(Component):
    """Inertial parameters.

    Args:
        rows: the data.
        mean: (n_params,) parameters of the URDF.
        index: (P,) of those that are fitted.
        scale: S (P, P).

    Attributes:
        target: (n, M) torques minus those of the mean.
    """

    local = False

    def __init__(self, rows: Rows, mean: np.ndarray, index: np.ndarray, scale: np.ndarray) -> None:
        self.mean, self.index, self.scale, self.n, self._rows = mean, index, scale, len(index), rows
        # Bodies that a joint does not move have no columns there.
        self._moved = [np.flatnonzero(np.isin(index, own)) for own in rows.columns.inertial]
        self._columns = [self._of(j, Y) for j, Y in enumerate(rows.rigid)]
        self.target = self._target_given(mean)

    def _of(self, joint: int, Y: np.ndarray) -> np.ndarray:
        """Return the columns (p, M) of the bodies that a joint moves, for a kappa of one; Y (M, p_j) as ``rigid``."""
        moved = self._moved[joint]
        fitted = np.isin(self._rows.columns.inertial[joint], self.index)
        return (Y[:, fitted] @ self.scale[np.ix_(moved, moved)]).T

    def _target_given(self, pi: np.ndarray) -> np.ndarray:
        return self._rows.tau - self._rows.load(pi)

    def felt_through(self, C: Sequence[np.ndarray], pi: np.ndarray) -> RigidBody:
        """Return the same bodies, which also act through an effect: tau = Y pi' + C (pi' - pi) + that of pi.

        Args:
            C: per joint, as ``Rows.rigid``.
            pi: (n_params,) in the effect's own columns, which are additional to the machine's.
        """
        other, rows = copy(self), self._rows
        both = zip(rows.rigid, C, strict=True)
        other._columns = [self._of(j, Y + more) for j, (Y, more) in enumerate(both)]
        own = zip(C, rows.columns.inertial, strict=True)
        other.target = self._target_given(self.mean) + np.stack([more @ (pi - self.mean)[at] for more, at in own])
        return other

    def at(self, joint: int) -> np.ndarray:
        return self.first + self._moved[joint]

    def columns(self, joint: int, learnt: Learnt, along: Along | None) -> tuple[np.ndarray, np.ndarray]:
        return self._columns[joint], self.at(joint)

    def sizes(self, joint: int, own: np.ndarray, learnt: Learnt) -> np.ndarray:
        return np.full(len(own), 1.0 / math.sqrt(learnt.kappa))

    def pi(self, z: np.ndarray, kappa: float) -> Tensor:
        """Return the inertial parameters (n_params,) of a model's coefficients z."""
        pi = self.mean.copy()
        pi[self.index] += self.scale @ z[self.first : self.first + self.n] / math.sqrt(kappa)
        return torch.from_numpy(pi)
