"""Dead zone of a drive: a recorded command within a zone around zero has no effect.

    tau_acting = u - w sign(u) beyond w, 0 within        so that  u = tau_acting + w sign(tau_acting)

Its causes are overlapped valves of hydraulic drives, the blanking time of power stages and thresholds of speed
controllers. The sign is that of the load, the torque that the actuator supplies to the rigid body and to friction.
While a command passes through the zone no torque acts, and the motion does not show where in the zone it is. Along a
sequence the model joins both sides by a straight line, from where abs(load) falls below ``indistinct`` to where it
rises above it again.

Source: Tao, Kokotovic, "Adaptive Control of Systems with Actuator and Sensor Nonlinearities", 1996, for the dead zone
    and its inverse.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor

from torchrbd.effects.base import CoefficientPrior, JointEffect, Shape
from torchrbd.effects.signals import JointScale, JointState


class TorqueDeadZone(JointEffect):
    """tau += w sign(load) with half-width w >= 0. The load is the torque that the actuator supplies.

    Along a sequence, the sign is joined by straight lines where abs(load) < ``indistinct``, a shape parameter.
    """

    id = "torque_dead_zone"
    family = "actuator and sensor"
    words = "dead zone of the drive"
    equation = "w sign(load)"
    shown_by = "Motion in which the load crosses zero often: torque jumps there, by twice the half width."
    of_drives = True
    units: ClassVar[Mapping[str, str]] = {"half_width": "{tau}", "indistinct": "{tau}"}
    uses_load = True
    sees_friction = True
    of_the_data = ("indistinct",)
    drawn_over = "load"
    prior = CoefficientPrior("A drive gives less torque than its command, not more.", positive=(0,))
    export_note = "MJCF has no dead zone of an actuator: add half_width times the sign of each command to it"
    # As fractions of the largest load.
    _LEAST, _MOST, _GRID_POINTS = 0.002, 0.064, 6

    def shapes(self, scale: JointScale) -> tuple[Shape, ...]:
        if not scale.load_max:
            return ({"indistinct": 0.0},)
        grid = scale.load_max * np.geomspace(self._LEAST, self._MOST, self._GRID_POINTS)
        return tuple({"indistinct": float(v)} for v in grid)

    def joint_features(self, state: JointState, shape: Shape) -> dict[str, Tensor]:
        load, least = state.supplied, shape["indistinct"]
        in_sequence = state.t is not None and state.t.shape == load.shape[-1:]
        sign = crossing(load, least) if in_sequence else torch.sign(load)
        return {f"sign(load; {least:.6g})": sign}

    def parameters(self, coefficients: Tensor, shape: Shape) -> dict[str, Tensor]:
        return {"half_width": coefficients[0], "indistinct": coefficients.new_tensor(shape["indistinct"])}

    def coefficients(self, parameters: Mapping[str, float]) -> tuple[tuple[float, ...], Shape]:
        return (parameters["half_width"],), {"indistinct": parameters.get("indistinct", 0.0)}

    def plausible(self, parameters: Mapping[str, float], scale: JointScale) -> bool:
        return parameters["half_width"] >= 0


def crossing(x: Tensor, least: float) -> Tensor:
    """Return the sign of a sequence x (*batch, N), joined by straight lines where abs(x) < ``least``.

    The moments at which abs(x) crosses ``least`` are interpolated linearly between samples.
    """
    at = torch.arange(x.shape[-1], device=x.device).expand_as(x)
    outside = x.abs() > least if least > 0 else torch.ones_like(x, dtype=torch.bool)
    last, end = torch.cummax(torch.where(outside, at, -1), -1).values, x.shape[-1]
    following = torch.cummin(torch.where(outside, at, end).flip(-1), -1).values.flip(-1)
    before, after = last.clamp_min(0), following.clamp_max(end - 1)
    # Before the first known sign, use the first one; after the last known sign, the last one.
    sign = torch.sign(x)
    begins = torch.where(last < 0, sign.gather(-1, after), sign.gather(-1, before))
    ends = torch.where(following == end, begins, sign.gather(-1, after))
    start = before + _part(x, before, (before + 1).clamp_max(end - 1), least)
    stop = after - _part(x, after, (after - 1).clamp_min(0), least)
    line = begins + (ends - begins) * _quotient(at - start, stop - start)
    return torch.where(outside, sign, line)


def _part(x: Tensor, outer: Tensor, inner: Tensor, least: float) -> Tensor:
    """Return the fraction of the way from samples above ``least`` to their neighbours below it where x is above it."""
    high, low = x.gather(-1, outer), x.gather(-1, inner)
    return _quotient(high.abs() - least, high.abs() - torch.sign(high) * low)


def _quotient(part: Tensor, whole: Tensor) -> Tensor:
    """Return part / whole, clamped to [0, 1]; 0 where the whole is 0."""
    there = whole > 0
    return torch.where(there, part / torch.where(there, whole, 1.0), 0.0).clamp(0.0, 1.0)
