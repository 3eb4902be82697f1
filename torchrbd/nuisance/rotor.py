"""Inertia of the rotors of geared drives: I_r qdd at each joint with a drive."""

from __future__ import annotations

import numpy as np

from torchrbd.dataset.rows import Rows
from torchrbd.nuisance.component import Along, Component, Learnt, nothing


class Rotor(Component):
    """Rotor inertia of joints whose torque is that of a drive: a gear multiplies it by the square of its ratio.

    Args:
        rows: the data.
        torque_rms: (n,) [N m or N].
    """

    def __init__(self, rows: Rows, torque_rms: np.ndarray) -> None:
        self._rows, self._torque_rms = rows, torque_rms
        self._joints = np.flatnonzero(rows.driven).tolist()
        self.n = len(self._joints)

    @property
    def index(self) -> np.ndarray:
        """Indices of all its coefficients, (n,)."""
        return self.first + np.arange(self.n)

    def at(self, joint: int) -> np.ndarray:
        return self.index[[self._joints.index(joint)]] if joint in self._joints else self.index[:0]

    def size(self, joint: int) -> float:
        """Return the inertia of a joint for a coefficient of one: its torque is all of the joint's."""
        rms = float(np.sqrt(np.mean(self._rows.qdd[joint] ** 2)))
        return float(self._torque_rms[joint]) / rms if rms > 0 else 0.0

    def columns(self, joint: int, learnt: Learnt, along: Along | None) -> tuple[np.ndarray, np.ndarray]:
        if joint not in self._joints:
            return nothing(len(self._rows.t))
        return self.size(joint) * self._rows.qdd[[joint]], self.at(joint)
