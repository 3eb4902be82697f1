"""How a table may have been written: what its columns mean instead of what they say.

    q = q_scale * q_read[q_order],   t = t_read * time,   tau = tau_scale * tau_read[tau_order]

with a gravity of its own. The table as it stands is the writing with all of these at one, in order, and zero.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from torch import Tensor


@dataclass(frozen=True)
class Writing:
    """What the columns of a table mean.

    Attributes:
        q_order, tau_order: (n_dof,) by joint, whose column holds its position, and its torque.
        q_scale, tau_scale: (n_dof,) what the columns are to be multiplied by.
        time: what times are to be multiplied by.
        gravity: in the base's axes [m/s^2].
    """

    q_order: tuple[int, ...]
    tau_order: tuple[int, ...]
    q_scale: tuple[float, ...]
    tau_scale: tuple[float, ...]
    gravity: tuple[float, ...]
    time: float = 1.0

    @classmethod
    def as_it_stands(cls, n_dof: int, gravity: Sequence[float]) -> Writing:
        """Return the writing of a table that means what it says."""
        order, one = tuple(range(n_dof)), (1.0,) * n_dof
        return cls(order, order, one, one, tuple(gravity))

    def scaled_q(self, joints: Sequence[int], factor: float) -> Writing:
        """Return the same with the positions of some joints times a factor."""
        return replace(self, q_scale=_scaled(self.q_scale, joints, factor))

    def scaled_tau(self, joints: Sequence[int], factor: float) -> Writing:
        """Return the same with the torques of some joints times a factor."""
        return replace(self, tau_scale=_scaled(self.tau_scale, joints, factor))

    def swapped(self, one: int, other: int, *, q: bool, tau: bool) -> Writing:
        """Return the same with the columns of two joints exchanged: positions, torques, or both."""
        return replace(
            self,
            q_order=_swapped(self.q_order, one, other) if q else self.q_order,
            tau_order=_swapped(self.tau_order, one, other) if tau else self.tau_order,
        )

    @property
    def motion(self) -> tuple[tuple[int, ...], tuple[float, ...], float, tuple[float, ...]]:
        """What the regressor of the rigid body depends on."""
        return self.q_order, self.q_scale, self.time, self.gravity

    def moved(self, q: Tensor, qd: Tensor, qdd: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return what the positions mean, (n_dof, N) each."""
        order, scale = list(self.q_order), q.new_tensor(self.q_scale).unsqueeze(1)
        return scale * q[order], scale / self.time * qd[order], scale / self.time**2 * qdd[order]

    def torque(self, tau: Tensor) -> Tensor:
        """Return what the torques (n_dof, M) mean."""
        return tau.new_tensor(self.tau_scale).unsqueeze(1) * tau[list(self.tau_order)]


def _scaled(scale: Sequence[float], joints: Sequence[int], factor: float) -> tuple[float, ...]:
    return tuple(value * factor if j in joints else value for j, value in enumerate(scale))


def _swapped(order: Sequence[int], one: int, other: int) -> tuple[int, ...]:
    found = list(order)
    found[one], found[other] = found[other], found[one]
    return tuple(found)
