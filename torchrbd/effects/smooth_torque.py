"""Smooth torque: a smooth function of one or two signals, for a residual that no known effect explains.

    tau += sum_k w_k h_k(v) phi,   h_k piecewise linear with the value 1 at knot k and 0 at the others

phi is 1, or sign(qd) for friction that varies with v. For two signals u and v, each from -1 to 1 over its range, the
functions are u v, u^2 v, u v^2 and u^2 v^2. Beyond its range a signal counts as at the end of it. The curve shows what
a torque depends on, not why. The coefficients are torques: the values of the curve at its knots.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import product

import torch
from torch import Tensor

from torchrbd.effects.base import Curve, Effect, Shape
from torchrbd.effects.signals import JointScale, Signals
from torchrbd.effects.sites import Site, Window
from torchrbd.robot import RobotModel

# pyright: reportAttributeAccessIssue=false
# (class attributes describe an effect; here they depend on the signal)

_POINTS = 400


class SmoothTorque(Effect):
    """A function of a signal of the joint itself, of another joint, or of time.

    Args:
        signal: "q", "qd", "qdd", "load" or "t".
        knots: number of knots of the function.
        friction: whether it multiplies sign(qd).
        other: whether the signal is another joint's.
        times_own: whether the function also depends on the joint's own signal of this kind.
    """

    family = "unknown"

    def __init__(
        self, signal: str, knots: int, *, friction: bool = False, other: bool = False, times_own: bool = False
    ) -> None:
        self.signal, self.knots, self.friction, self.other, self.times_own = signal, knots, friction, other, times_own
        name = signal + ("_of_other" if other else "") + ("_and_own" if times_own else "")
        self.id = f"smooth_{'friction' if friction else 'torque'}_over_{name}"
        self.words = f"{'friction' if friction else 'a torque'} that depends on {name.replace('_', ' ')}"
        self.equation = "f(v) sign(qd)" if friction else "f(v)"
        unit = {"q": "{q}", "qd": "{q}/s", "qdd": "{q}/s^2", "load": "{tau}", "t": "s"}[signal]
        ends = ("low", "high", "own_low", "own_high") if times_own else ("low", "high")
        self._values = tuple(f"value_{k + 1}" for k in range(knots))
        self.units = {**dict.fromkeys(self._values, "{tau}"), **dict.fromkeys(ends, unit)}
        self.uses_load = signal == "load"
        self.has_memory = signal == "t"

    def sites(self, robot: RobotModel, windows: Sequence[Window] = ()) -> tuple[Site, ...]:
        joints = range(robot.n_dof)
        if self.other:
            return tuple(Site(j, other=k) for j in joints for k in joints if k != j)
        if self.signal == "t":
            return tuple(Site(j, window=w) for j in joints for w in windows)
        return tuple(Site(j) for j in joints)

    def shapes(self, scale: JointScale) -> tuple[Shape, ...]:
        """Return the range of the knots as far as ``scale`` gives it; the samples give a better one."""
        most = {"qd": scale.speed_max, "load": scale.load_max or 1.0}.get(self.signal, 1.0)
        ends = {"q": (scale.q_low, scale.q_high), "t": (0.0, scale.duration_s)}.get(self.signal, (-most, most))
        own = {"own_low": ends[0], "own_high": ends[1]} if self.times_own else {}
        return ({"low": ends[0], "high": ends[1], **own},)

    def features(self, signals: Signals, site: Site, shape: Shape) -> dict[str, Tensor]:
        assert site.joint is not None
        joint = site.other if self.other and site.other is not None else site.joint
        values = _hats(self.values(signals, joint), shape["low"], shape["high"], self.knots)
        if self.times_own:
            u = _within(self.values(signals, joint), shape["low"], shape["high"])
            v = _within(self.values(signals, site.joint), shape["own_low"], shape["own_high"])
            values = torch.stack([u**a * v**b for a, b in product((1, 2), repeat=2)])
        values = values * signals.inside(site.window)
        if self.friction:
            values = values * signals.joint(site.joint).direction()
        place = f"{self.id} {site.other} {site.window} {tuple(shape.values())}"
        return {f"{place} {name}": v for name, v in zip(self._values, values, strict=True)}

    def values(self, signals: Signals, joint: int) -> Tensor:
        """Return the signal of a joint, (*batch)."""
        if self.signal == "t":
            return signals.sequence().to(signals.q).expand_as(signals.q[joint])
        return getattr(signals, self.signal)[joint]

    def parameters(self, coefficients: Tensor, shape: Shape) -> dict[str, Tensor]:
        values = dict(zip(self._values, coefficients, strict=True))
        return {**values, **{name: coefficients.new_tensor(v) for name, v in shape.items()}}

    def coefficients(self, parameters: Mapping[str, float]) -> tuple[tuple[float, ...], Shape]:
        ends = {name: v for name, v in parameters.items() if name not in self._values}
        return tuple(parameters[name] for name in self._values), ends

    def curve(self, coefficients: Tensor, shape: Shape, scale: JointScale) -> Curve | None:
        if self.times_own:
            return None
        x = torch.linspace(shape["low"], shape["high"], _POINTS, dtype=torch.float64)
        h = _hats(x, shape["low"], shape["high"], self.knots)
        return Curve(self.signal + ("_other" if self.other else ""), x, coefficients.to(x) @ h)

    def plausible(self, parameters: Mapping[str, float], scale: JointScale) -> bool:
        return True


class Hum(SmoothTorque):
    """Torque of one frequency, whatever the motion: tau += a_r cos(2 pi f t) + b_r sin(2 pi f t) in recording r."""

    of_each_recording = True

    def __init__(self) -> None:
        super().__init__("t", 2)
        self.id, self.words, self.equation = "hum", "a hum", "a cos(2 pi f t) + b sin(2 pi f t)"
        self._values = ("cosine", "sine")
        self.units = {**dict.fromkeys(self._values, "{tau}"), "frequency": "Hz"}

    def shapes(self, scale: JointScale) -> tuple[Shape, ...]:
        """Return a placeholder; the spectrum of the residual gives the frequency."""
        return ({"frequency": 1.0},)

    def features(self, signals: Signals, site: Site, shape: Shape) -> dict[str, Tensor]:
        assert site.joint is not None
        assert site.recordings is not None
        angle, found = 2.0 * math.pi * shape["frequency"] * self.values(signals, site.joint), dict[str, Tensor]()
        for recording in site.recordings:
            inside, name = float(signals.recording == recording), f"{self.id} {recording} {shape['frequency']:.6g}"
            found |= {f"{name} cosine": angle.cos() * inside, f"{name} sine": angle.sin() * inside}
        return found

    def parameters(self, coefficients: Tensor, shape: Shape) -> dict[str, Tensor]:
        """Return the parameters in the first recording of the site."""
        return super().parameters(coefficients[: len(self._values)], shape)

    def sites(self, robot: RobotModel, windows: Sequence[Window] = ()) -> tuple[Site, ...]:
        """Return one site for each joint and recording; a site may also have several recordings."""
        return tuple(Site(j, recordings=(w.recording,)) for j in range(robot.n_dof) for w in windows)

    def curve(self, coefficients: Tensor, shape: Shape, scale: JointScale) -> Curve | None:
        return None


def _within(v: Tensor, low: float, high: float) -> Tensor:
    """Return v scaled from -1 at one end of its range to 1 at the other."""
    return (2.0 * v.clamp(low, high) - low - high) / (high - low)


def _hats(v: Tensor, low: float, high: float, knots: int) -> Tensor:
    """Return the functions h_k, (knots, *batch)."""
    at = (_within(v, low, high) + 1.0) / 2.0 * (knots - 1)
    k = torch.arange(knots, dtype=v.dtype, device=v.device).reshape(-1, *[1] * v.ndim)
    return (1.0 - (at - k).abs()).clamp_min(0.0)


SMOOTH = (
    SmoothTorque("q", 21),
    SmoothTorque("qd", 15),
    SmoothTorque("qdd", 9),
    SmoothTorque("load", 15),
    SmoothTorque("t", 25),
    SmoothTorque("q", 21, friction=True),
    SmoothTorque("load", 9, friction=True),
    SmoothTorque("q", 9, other=True),
    SmoothTorque("qd", 9, other=True),
    SmoothTorque("q", 7, friction=True, other=True),
    SmoothTorque("qd", 4, other=True, times_own=True),
)
"""Functions that are tried on the residual of a joint."""
HUM = Hum()
"""Tried where the residual has a spectral line."""
