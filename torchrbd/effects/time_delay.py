"""Time delay: torque and motion were not recorded at the same time; the torque is late or early by a constant time."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import ClassVar

import torch
from torch import Tensor

from torchrbd.effects.band_limits import BANDWIDTHS_HZ, UNLIMITED_HZ, below
from torchrbd.effects.base import CoefficientPrior, Effect, Mjcf, Shape
from torchrbd.effects.signals import JointScale, Signals
from torchrbd.effects.sites import Site, Window
from torchrbd.robot import RobotModel


class TimeDelay(Effect):
    """tau += delay (tau_s(t - step) - tau_s(t)) / step: the torque is later than the motion if delay > 0.

    tau_s is the torque that the actuator supplies to the rigid body and to friction. The fraction is the slope of a
    secant. Its width ``step`` is a shape parameter that follows the delay; the term is exact where both are equal.

    The derivative of the rigid-body torque amplifies the noise of the positions. It is therefore low-pass filtered
    (``below``); the data choose the cut-off frequency ``bandwidth``, a shape parameter. The jumps of friction are known
    and not filtered.

    The effect acts at one joint, or at all joints with one delay.
    """

    id = "time_delay"
    family = "actuator and sensor"
    words = "time delay of the torque"
    equation = "delay (tau_s(t - step) - tau_s(t)) / step"
    shown_by = (
        "Fast motion with quick changes of torque: torque comes later than the motion, by one time at all frequencies."
    )
    units: ClassVar[Mapping[str, str]] = {"delay": "s", "step": "s", "bandwidth": "Hz"}
    whole_robot = True
    uses_load = True
    has_memory = True
    sees_friction = True
    follows = ("step",)
    of_the_data = ("bandwidth",)
    shifts_clocks = True
    prior = CoefficientPrior("Some samples of a field bus, early or late.", std=(0.02,))
    export_note = "delays need a history: nsample = delay / timestep; of one joint or, for the whole robot, of all"
    _SMALL_S, _LARGEST_S, _MOST_APART = 1e-3, 0.1, 2.0

    def sites(self, robot: RobotModel, windows: Sequence[Window] = ()) -> tuple[Site, ...]:
        return joints_and_all(robot)

    def shapes(self, scale: JointScale) -> tuple[Shape, ...]:
        return tuple({"step": self._SMALL_S, "bandwidth": hz} for hz in BANDWIDTHS_HZ)

    def agreeing(self, coefficients: Tensor, shape: Shape) -> Shape:
        return {**shape, "step": self._step(float(coefficients[0]))}

    def _step(self, delay: float) -> float:
        """Return the width of the secant for a delay; a very short delay gets the shortest width."""
        return math.copysign(max(abs(delay), self._SMALL_S), delay)

    def features(self, signals: Signals, site: Site, shape: Shape) -> dict[str, Tensor]:
        t, band = signals.sequence(), shape["bandwidth"]
        step = shape["step"] or self._SMALL_S
        dt = float(t[1] - t[0])

        def secant(torque: Tensor) -> Tensor:
            return (delayed(torque, step / dt) - torque) / step

        of_load = at_site(signals.load, site, lambda x: below(secant(x), dt, band))
        slope = of_load + at_site(signals.friction_torque, site, secant)
        return {f"delayed({step:.6g}, {band:.6g} Hz) {site.name(signals.robot)}": slope}

    def parameters(self, coefficients: Tensor, shape: Shape) -> dict[str, Tensor]:
        shapes = {name: coefficients.new_tensor(shape[name]) for name in ("step", "bandwidth")}
        return {"delay": coefficients[0], **shapes}

    def coefficients(self, parameters: Mapping[str, float]) -> tuple[tuple[float, ...], Shape]:
        """Return w and the shape; without a step, the step equals the delay."""
        delay = parameters["delay"]
        return (delay,), {
            "step": parameters.get("step", delay or self._SMALL_S),
            "bandwidth": parameters.get("bandwidth", UNLIMITED_HZ),
        }

    def plausible(self, parameters: Mapping[str, float], scale: JointScale) -> bool:
        delay, step = parameters["delay"], parameters["step"]
        near = abs(step) <= self._SMALL_S or abs(step) / self._MOST_APART <= delay * math.copysign(1.0, step)
        return abs(delay) <= self._LARGEST_S and near

    def of_clock_offset(self, delay_s: float) -> dict[str, float]:
        return {"delay": delay_s}

    def mjcf(self, parameters: Mapping[str, float]) -> Mjcf:
        delay = parameters["delay"]
        return {"actuatorfrc": {"delay": delay}} if delay > 0 else {"general": {"delay": -delay}}


def joints_and_all(robot: RobotModel) -> tuple[Site, ...]:
    """Return each joint and the robot as a whole."""
    joints = tuple(Site(joint) for joint in range(robot.n_dof))
    return joints if len(joints) == 1 else (*joints, Site())


def at_site(torque: Tensor, site: Site, change: Callable[[Tensor], Tensor]) -> Tensor:
    """Return ``change`` of torques (n, *batch), joint by joint; zero at other joints if the site has a joint."""
    if site.joint is None:
        return change(torque)
    only = torch.zeros(len(torque), *[1] * (torque.ndim - 1), dtype=torque.dtype, device=torque.device)
    only[site.joint] = 1.0
    return change(torque[site.joint]) * only


def delayed(x: Tensor, steps: float) -> Tensor:
    """Return x (..., N) later by a number of samples: cubic interpolation, linear extrapolation at the ends."""
    whole = math.floor(steps)
    part, reach = steps - whole, abs(whole) + 2
    outwards = torch.arange(1, reach + 1, dtype=x.dtype, device=x.device)
    before = x[..., :1] - outwards.flip(0) * (x[..., 1:2] - x[..., :1])
    after = x[..., -1:] + outwards * (x[..., -1:] - x[..., -2:-1])
    padded, n = torch.cat((before, x, after), -1), x.shape[-1]
    result = torch.zeros_like(x)
    nodes = (-1, 0, 1, 2)
    for node in nodes:
        weight = math.prod((part - other) / (node - other) for other in nodes if other != node)
        first = reach - whole - node
        result = result + weight * padded[..., first : first + n]
    return result
