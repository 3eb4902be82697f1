"""A part of a machine's torque: columns of each joint's rows, for coefficients with the prior N(0, 1).

    tau_j = sum over components, sum_k z_k size_jk column_jk

Rigid body, nuisances, effects and smooth curves are components alike.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Protocol

import numpy as np
from torch import Tensor

from torchrbd.effects import Signals

Along = Mapping[str, np.ndarray]
"""Features along the motion (..., n, M) by name, for one load and friction."""


class Learnt(Protocol):
    """What columns depend on, and is learnt."""

    @property
    def kappa(self) -> float:
        """Inverse square of the error of the URDF's inertial parameters."""
        ...

    @property
    def rest_width(self) -> np.ndarray:
        """Speeds (n,) over which friction changes its sign [rad/s, m/s]."""
        ...

    @property
    def drift(self) -> np.ndarray:
        """Standard deviation (n,) of the slowest cosine [N m or N]."""
        ...

    @property
    def held(self) -> np.ndarray:
        """Prior size (n,) of the friction that holds a joint at rest [N m or N]."""
        ...

    @property
    def friction(self) -> Tensor:
        """Friction (n, 3) in addition to the load, see ``Signals``."""
        ...

    @property
    def white(self) -> bool:
        """Whether rows count as independent, as in least squares."""
        ...


class Component(ABC):
    """One part of a model.

    Attributes:
        n: number of coefficients.
        first: index of the first one in the model.
        local: whether each coefficient belongs to one joint alone.
    """

    n: int
    first: int = 0
    local: bool = True

    def along(self) -> Mapping[str, Callable[[Signals], Tensor]]:
        """Return functions of the signals, (..., n, N), that its columns need; equal names mean equal functions."""
        return {}

    @abstractmethod
    def at(self, joint: int) -> np.ndarray:
        """Return the indices (K,) of the coefficients that a joint may have, in the model."""

    @abstractmethod
    def columns(self, joint: int, learnt: Learnt, along: Along | None) -> tuple[np.ndarray, np.ndarray]:
        """Return columns (K, M) of a joint without their ``sizes`` and the indices (K,) of their coefficients.

        Args:
            joint: its index.
            learnt: the present values.
            along: features of all components, see ``along``; without them what needs them is left out.
        """

    def sizes(self, joint: int, own: np.ndarray, learnt: Learnt) -> np.ndarray:
        """Return the factors (K,) of columns, by the indices of their coefficients, that give prior coordinates.

        They are learnt more often than the columns themselves.
        """
        return np.ones(len(own))


class OfEachJoint(Component):
    """A component with the same number of coefficients at each joint.

    Args:
        n_dof: number of joints.
        each: number of coefficients of one.
    """

    def __init__(self, n_dof: int, each: int) -> None:
        self.n, self._each = n_dof * each, each

    def at(self, joint: int) -> np.ndarray:
        return self.first + joint * self._each + np.arange(self._each)


def nothing(rows: int) -> tuple[np.ndarray, np.ndarray]:
    """Return no columns of so many rows."""
    return np.zeros((0, rows)), np.zeros(0, dtype=int)
