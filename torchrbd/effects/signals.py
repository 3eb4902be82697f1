"""The inputs of effects: the signals of one joint, or of the whole robot."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import torch
from torch import Tensor

from torchrbd.effects.sites import Window
from torchrbd.errors import InputError
from torchrbd.robot import RobotModel

# A joint moves if its speed reaches this multiple of ``rest_width``.
_MOVES = 3.0
# Number of points of a curve.
_SWEEP = 1000


T = TypeVar("T")


class computed_once(Generic[T]):  # noqa: N801
    """A property that is computed when it is first asked for: functools' ``cached_property`` without its lock, which no
    compiler traces (Python 3.12 has dropped it)."""

    def __init__(self, compute: Callable[[Any], T]) -> None:
        self._compute, self.__doc__ = compute, compute.__doc__

    def __set_name__(self, owner: type, name: str) -> None:
        self._name = name

    def __get__(self, instance: Any, owner: type) -> T:
        value = instance.__dict__[self._name] = self._compute(instance)
        return value


@dataclass(frozen=True)
class JointState:
    """The signals of one joint; all but t have one common shape.

    ``rest_width`` is the speed [rad/s, m/s] below which the direction of motion is uncertain: sign(qd) is tanh(qd /
    rest_width). ``load`` is the rigid-body torque, for effects that use it, ``friction`` the friction torque, if any.
    ``temperature`` and ``t`` are as in ``Signals``. ``turned`` (R,) are the positions before the first sample at which
    the joint changed its direction [rad, m].
    """

    q: Tensor
    qd: Tensor
    qdd: Tensor
    rest_width: Tensor | float
    load: Tensor | None = None
    temperature: Tensor | None = None
    t: Tensor | None = None
    friction: Tensor | None = None
    turned: Tensor | None = None

    @property
    def supplied(self) -> Tensor:
        """Torque that the actuator supplies: load and friction [N m, N]."""
        assert self.load is not None
        return self.load if self.friction is None else self.load + self.friction

    def direction(self) -> Tensor:
        """Return sign(qd), softened below ``rest_width``."""
        return torch.tanh(self.qd / self.rest_width)

    def times(self) -> Tensor:
        """Return t, of any shape that broadcasts with the samples.

        Raises:
            InputError: there is none.
        """
        return _times(self.t)

    def sequence(self) -> Tensor:
        """Return t (N,).

        Raises:
            InputError: the samples are not a sequence.
        """
        return _sequence(self.t)


@dataclass(frozen=True)
class JointScale:
    """The range of the recordings at one joint: shapes are searched in it, and parameters are plausible in it.

    Attributes:
        speed_max: [rad/s, m/s].
        rest_width: see ``JointState``.
        q_low, q_high: [rad, m].
        lower, upper: the joint's limits [rad, m]; infinite if unknown.
        load_max: largest torque that the actuator supplies [N m, N]; None if unknown.
        duration_s: of the longest recording.
        temperature: lowest and highest [deg C]; None if not recorded.
    """

    speed_max: float
    rest_width: float
    q_low: float = -math.pi
    q_high: float = math.pi
    load_max: float | None = None
    duration_s: float = 300.0
    temperature: tuple[float, float] | None = None
    lower: float = -math.inf
    upper: float = math.inf

    @property
    def joint_range(self) -> tuple[float, float]:
        """The range of the joint [rad, m]: its limits; where these are unknown, three times what it has covered."""
        span = self.q_high - self.q_low
        lower = self.lower if math.isfinite(self.lower) else self.q_low - span
        upper = self.upper if math.isfinite(self.upper) else self.q_high + span
        return min(lower, self.q_low), max(upper, self.q_high)

    @property
    def moves(self) -> bool:
        """Whether the joint moves faster than what counts as rest."""
        return self.speed_max > _MOVES * self.rest_width

    def sweep(self, signal: str) -> JointState | None:
        """Return a joint at its largest speed while one of its signals runs through its range.

        The position stays in the middle, the load at its largest, the temperature at its lowest.

        Args:
            signal: a field of ``JointState``.

        Returns:
            (_SWEEP,) each; None if the range is not known.
        """
        middle, half = 0.5 * (self.q_low + self.q_high), 0.5 * (self.q_high - self.q_low)
        fastest, load = self.speed_max, self.load_max
        # The acceleration of a sine with this speed and range.
        hardest = fastest**2 / half if half > 0 else fastest
        ranges = {
            "q": (self.q_low, self.q_high),
            "qd": (-fastest, fastest),
            "qdd": (-hardest, hardest),
            "t": (0.0, self.duration_s),
            **({} if load is None else {"load": (-load, load)}),
            **({} if self.temperature is None else {"temperature": self.temperature}),
        }
        if signal not in ranges:
            return None
        still = {"q": middle, "qd": fastest, "qdd": 0.0, "t": 0.0, "load": load}
        still["temperature"] = None if self.temperature is None else self.temperature[0]
        at = {
            name: torch.linspace(*(ranges[name] if name == signal else (value, value)), _SWEEP, dtype=torch.float64)
            for name, value in still.items()
            if value is not None
        }
        return JointState(**at, rest_width=self.rest_width)


@dataclass(frozen=True)
class Signals:
    """The signals of a robot. Joints are the first dimension; time is the last one if the samples are a sequence.

    Attributes:
        robot: the robot.
        q, qd, qdd: (n, *batch) [rad, m] and per second, per second squared.
        rest_width: (n,) see ``JointState``.
        pi: (n_params,) inertial parameters for the load; the robot's own if None.
        t: (N,) times of the last dimension, evenly spaced [s]. Samples that are not a sequence have None, or a shape
            that broadcasts: one time, or (1, N).
        recording: its name; None outside of recordings.
        temperature: (n, *batch) of the joints [deg C]; None if not recorded.
        friction: (n, 3) viscous and Coulomb coefficient and offset of each joint, which add to the load in the torque
            that its actuator supplies, see ``plain_friction``; no friction if None.
        turned: per joint, the positions at which it changed direction before the samples, see ``States``; empty if
            unknown.
    """

    robot: RobotModel
    q: Tensor
    qd: Tensor
    qdd: Tensor
    rest_width: Tensor
    pi: Tensor | None = None
    t: Tensor | None = None
    recording: str | None = None
    temperature: Tensor | None = None
    friction: Tensor | None = None
    turned: tuple[Tensor, ...] = ()

    def joint(self, joint: int | None, *, load: bool = False) -> JointState:
        """Return the signals of one joint, with or without its load."""
        assert joint is not None
        warm = None if self.temperature is None else self.temperature[joint]
        carried = self.load[joint] if load else None
        own_friction = None if carried is None or self.friction is None else self.friction_torque[joint]
        states = self.q[joint], self.qd[joint], self.qdd[joint]
        before = self.turned[joint] if self.turned else None
        return JointState(*states, self.rest_width[joint], carried, warm, self.t, own_friction, before)

    @computed_once
    def load(self) -> Tensor:
        """Torque of the rigid body, (n, *batch) [N m] or [N]."""
        return self.robot.inverse_dynamics(*self._states, self._own_pi).movedim(-1, 0).contiguous()

    @computed_once
    def friction_torque(self) -> Tensor:
        """Torque of ``friction``, (n, *batch) [N m] or [N]."""
        if self.friction is None:
            return torch.zeros_like(self.qd)
        return self._each(self.friction[:, 0]) * self.qd + self.coulomb_torque + self._each(self.friction[:, 2])

    @property
    def coulomb_torque(self) -> Tensor:
        """The Coulomb part of the friction torque, (n, *batch) [N m] or [N]."""
        if self.friction is None:
            return torch.zeros_like(self.qd)
        return self._each(self.friction[:, 1]) * self.directions

    @property
    def directions(self) -> Tensor:
        """Softened signs of the velocities, (n, *batch)."""
        return torch.tanh(self.qd / self._each(self.rest_width))

    def _each(self, values: Tensor) -> Tensor:
        """Return values (n,) of the joints in a shape that broadcasts with the samples, (n, 1, ...)."""
        return values.to(self.qd).reshape(-1, *[1] * (self.qd.ndim - 1))

    @property
    def supplied(self) -> Tensor:
        """Torque that the actuators supply: rigid body and friction, (n, *batch) [N m] or [N]."""
        return self.load + self.friction_torque

    @computed_once
    def origin_slopes(self) -> Tensor:
        """Derivatives of the load with respect to shifts and turns of the joints' origins, (*batch, n, n, 6)."""
        return self.robot.origin_slopes(*self._states, self._own_pi)

    @computed_once
    def regressor(self) -> Tensor:
        """Regressor of the rigid body, (*batch, n, n_params)."""
        return self.robot.regressor(*self._states)

    @computed_once
    def load_slopes(self) -> Tensor:
        """Derivatives of each joint's load with respect to q, qd and qdd of each joint, (3, n, n, *batch)."""
        return self.robot.torque_slopes(*self._states, self._own_pi).movedim((-3, -2, -1), (0, 1, 2)).contiguous()

    def deviating(self, joint: int | None, shift: Tensor) -> Tensor:
        """Return the change of the load (n, *batch) when a joint's link deviates by ``shift`` (*batch) over time."""
        assert joint is not None
        speed = self.rate(shift)
        by_q, by_qd, by_qdd = self.load_slopes[:, :, joint].unbind(0)
        return torch.addcmul(torch.addcmul(by_q * shift, by_qd, speed), by_qdd, self.rate(speed))

    @property
    def _states(self) -> tuple[Tensor, Tensor, Tensor]:
        return self.q.movedim(0, -1), self.qd.movedim(0, -1), self.qdd.movedim(0, -1)

    @property
    def _own_pi(self) -> Tensor | None:
        return None if self.pi is None else self.pi.to(self.q)

    def sequence(self) -> Tensor:
        """Return t (N,).

        Raises:
            InputError: the samples are not a sequence.
        """
        return _sequence(self.t)

    def rate(self, x: Tensor) -> Tensor:
        """Return dx/dt (..., N) by central differences."""
        t = self.sequence()
        return torch.gradient(x, spacing=float(t[1] - t[0]), dim=-1)[0]

    def inside(self, window: Window | None) -> Tensor:
        """Return 1 inside a window (its end excluded), 0 outside, as the last dimension of q; 1 everywhere for None."""
        if window is None:
            return torch.ones_like(self.q[0])
        if self.recording != window.recording:
            return torch.zeros_like(self.q[0])
        t = _times(self.t)
        return ((t >= window.start_s) & (t < window.end_s)).to(self.q).expand_as(self.q[0])


def _times(t: Tensor | None) -> Tensor:
    if t is None:
        raise InputError("an effect that depends on time needs t: one time, or (N,) those of the last dimension [s]")
    return t


def _sequence(t: Tensor | None) -> Tensor:
    if t is None or t.ndim != 1:
        raise InputError(
            "an effect with memory needs a sequence: give t (N,), evenly spaced seconds, with q, qd and qdd "
            "(*batch, N, n_dof); it has no forward dynamics"
        )
    return t
