"""A model as a plant under a torque: mass, forces of the rigid body, and forces that are balanced within a step.

A model's terms are of three kinds here:

- plain friction, offsets and rotors, which are numbers by joint and act on all windows at once;
- other terms of the present state, computed by the module;
- terms that take a whole motion (delays, play, springs in the drive) or are not linear in the acceleration. They are
  small compared with the rest. Their torque is that of the recorded motion, subtracted from the driving torque.

Presliding friction counts as the Coulomb friction that it becomes: its state at the start is not known.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from torchrbd.effects import Term
from torchrbd.effects.base import ACCELERATION, DIRECTION, LEVEL, SPEED, UNEVENNESS
from torchrbd.effects.coulomb_friction import CoulombFriction
from torchrbd.effects.presliding_hysteresis import PreslidingHysteresis
from torchrbd.effects.smooth_torque import SmoothTorque
from torchrbd.effects.torque_dead_zone import TorqueDeadZone
from torchrbd.effects.torque_saturation import TorqueSaturation
from torchrbd.model import RigidBodyDynamics
from torchrbd.recordings import States

# Of a joint's width of rest; families whose torque does not depend on accelerations.
_SLOWEST, _OF_VELOCITY = 1e-2, ("friction", "spring")
# Longer than any recording [s].
_LONG_S = 1e6


@dataclass(frozen=True)
class Conditions:
    """What a torque may depend on, besides the states of W windows.

    Attributes:
        t: (W,) times from the recording's start [s].
        temperature: (W, n_dof) [deg C], or None.
        recording: its name, or None.
    """

    t: Tensor
    temperature: Tensor | None = None
    recording: str | None = None


class Plant:
    """A model in float64, without gradients.

    Args:
        model: what moves.
        loaded: (n_params,) inertial parameters of a known load; None without one.

    Attributes:
        robot: the model's.
        along: terms whose torque is that of the recorded motion.
        slowest: (n_dof,) speed that counts as rest [rad/s, m/s].
        is_bare: whether no term of the present state adds to the rigid body's torque.
        conditional: whether it depends on more than the states.
    """

    def __init__(self, model: RigidBodyDynamics, loaded: Tensor | None = None) -> None:
        pi, width = model.pi.detach(), model.rest_width
        pi = pi if loaded is None else pi + loaded
        terms = [_sliding(copy.deepcopy(term)) for term in model.terms]  # frozen below: the model stays as it is
        self.along = tuple(term for term in terms if _takes_a_motion(term))
        instant = [term for term in terms if not _takes_a_motion(term)]
        # What alters a supplied torque needs the friction as well.
        by_joint = [] if any(term.effect.sees_friction for term in instant) else [t for t in instant if _is_plain(t)]
        others = [term for term in instant if term not in by_joint]
        self.robot, self.slowest, self._pi, self._width = model.robot, _SLOWEST * width, pi, width
        self._viscous, self._offset, self._coulomb, self._uneven, self._armature = (
            _sums(width, by_joint, label) for label in (SPEED, LEVEL, DIRECTION, UNEVENNESS, ACCELERATION)
        )

        def of(some: Iterable[Term]) -> RigidBodyDynamics:
            return RigidBodyDynamics(model.robot, pi, some, width).requires_grad_(False)

        self._whole, self._instant, self._others = of(terms), of(instant), of(others)
        moving = [term for term in others if _depends_on_velocity(of([term]), term)]
        still = [term for term in others if term not in moving]
        self._moving, self._still = (of(some) if some else None for some in (moving, still))
        self._weighs = any(t.effect.family not in _OF_VELOCITY or t.effect.uses_load for t in others)
        self.is_bare = all(t.effect.of_rotor for t in by_joint) and not others
        self.conditional = any(not t.site.always or t.effect.of_conditions for t in others)

    def mass(self, q: Tensor, at: Conditions) -> Tensor:
        """Return how torque grows with acceleration at q (W, n_dof), (W, n_dof, n_dof)."""
        if self._weighs:
            mass = self._others.mass_matrix(q.unsqueeze(0), at.t, at.recording)[0]
        else:
            mass = self.robot.mass_matrix(q, self._pi)
        return mass + torch.diag(self._armature)

    def rigid(self, q: Tensor, qd: Tensor) -> Tensor:
        """Return the rigid body's torque without acceleration, (W, n_dof)."""
        return self.robot.inverse_dynamics(q, qd, torch.zeros_like(q), self._pi)

    def terms(self, q: Tensor, at: Conditions) -> Callable[[Tensor], Tensor]:
        """Return the torque of terms of the present state, as a function of velocities (..., W, n_dof).

        What does not depend on the velocity is computed once.
        """
        fixed = self._offset
        if self._still is not None:
            fixed = fixed + self._torque(self._still, q, torch.zeros_like(q), at)

        def of_velocity(qd: Tensor) -> Tensor:
            way = torch.tanh(qd / self._width)
            plain = self._viscous * qd + self._coulomb * way + self._uneven * way.abs() + fixed
            return plain if self._moving is None else plain + self._torque(self._moving, q, qd, at)

        return of_velocity

    @staticmethod
    def _torque(model: RigidBodyDynamics, q: Tensor, qd: Tensor, at: Conditions) -> Tensor:
        shape = np.broadcast_shapes(q.shape, qd.shape)
        q, qd = (x.expand(shape).reshape(-1, *shape[-2:]) for x in (q, qd))
        return model.term_torque(q, qd, torch.zeros_like(q), at.t[None], at.temperature, at.recording).reshape(shape)

    def of_recorded_motion(self, states: States) -> Tensor | None:
        """Return the torque of terms along the motion of a tile, (N, n_dof), in the torque of a recording; or None."""
        if not self.along:
            return None
        warm = None if states.temperature is None else states.temperature.T
        with_all, without = (
            model.term_torque(states.q.T, states.qd.T, states.qdd.T, states.t, warm, states.recording)
            for model in (self._whole, self._instant)
        )
        return with_all - without


def _sliding(term: Term) -> Term:
    """Return presliding friction as the Coulomb friction that it becomes, and any other term as it is."""
    if not isinstance(term.effect, PreslidingHysteresis):
        return term
    return Term(CoulombFriction(), term.site, term.coefficients, {})


def _depends_on_velocity(model: RigidBodyDynamics, term: Term) -> bool:
    """Say whether the torque of a term depends on the velocity, given the model of it alone.

    It does if it has a derivative by it, or differs between velocities: a comparison has no derivative.
    """
    window, (name, *_) = term.site.window, term.site.recordings or (None,)
    qd = torch.linspace(-1.0, 1.0, 3, dtype=torch.float64).unsqueeze(1).repeat(1, model.robot.n_dof).requires_grad_()
    q, t = torch.full_like(qd, 0.1), torch.zeros(3, dtype=torch.float64)
    if window is not None:
        name, t = window.recording, t + 0.5 * (max(window.start_s, -_LONG_S) + min(window.end_s, _LONG_S))
    with torch.enable_grad():
        torque = model.term_torque(q, qd, torch.zeros_like(q), t, q, name)
    return torque.requires_grad or bool((torque != torque[:1]).any())


def _is_plain(term: Term) -> bool:
    return term.site.always and bool(term.effect.plain_columns)


def _sums(like: Tensor, terms: Iterable[Term], label: str) -> Tensor:
    """Return the sums of the coefficients of a column by joint, (n_dof,)."""
    total = torch.zeros_like(like)
    for term in terms:
        for own, w in zip(term.effect.plain_columns, term.coefficients.detach(), strict=True):
            if own == label and term.site.joint is not None:
                total[term.site.joint] += w
    return total


def _takes_a_motion(term: Term) -> bool:
    effect = term.effect
    if isinstance(effect, SmoothTorque) and effect.signal in ("qdd", "load") and not effect.friction:
        return True
    return effect.has_memory or isinstance(effect, (TorqueSaturation, TorqueDeadZone))
