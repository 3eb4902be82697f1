"""Dead zone of a drive: of the command that is recorded, what is within a zone around zero does not act.

    tau_acting = u - w sign(u) beyond w, 0 within        so that  u = tau_acting + w sign(tau_acting)

Overlapped valves of hydraulic drives, the blanking time of power stages and thresholds of speed controllers make one.
The sign is that of the load, the torque that the actuator supplies to the rigid body and to friction.

Source: Tao, Kokotovic, "Adaptive Control of Systems with Actuator and Sensor Nonlinearities", 1996, for the dead zone
    and its inverse.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import torch
from torch import Tensor

from torchrbd.effects.base import CoefficientPrior, JointEffect, Shape
from torchrbd.effects.signals import JointScale, JointState


class TorqueDeadZone(JointEffect):
    """tau += w sign(load) with w >= 0."""

    id = "torque_dead_zone"
    family = "actuator and sensor"
    words = "dead zone of the drive"
    equation = "w sign(load)"
    units: ClassVar[Mapping[str, str]] = {"half_width": "{tau}"}
    uses_load = True
    sees_friction = True
    drawn_over = "load"
    prior = CoefficientPrior("A drive gives less than is asked, not more.", positive=(0,))
    export_note = "MJCF has no dead zone of an actuator: add half_width times the sign of each command to it"

    def joint_features(self, state: JointState, shape: Shape) -> dict[str, Tensor]:
        return {"sign(load)": torch.sign(state.supplied)}

    def parameters(self, coefficients: Tensor, shape: Shape) -> dict[str, Tensor]:
        return {"half_width": coefficients[0]}

    def coefficients(self, parameters: Mapping[str, float]) -> tuple[tuple[float, ...], Shape]:
        return (parameters["half_width"],), {}

    def plausible(self, parameters: Mapping[str, float], scale: JointScale) -> bool:
        return parameters["half_width"] >= 0
