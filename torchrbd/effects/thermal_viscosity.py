"""Thermal viscosity: a lubricant thins as it warms, so viscous friction falls with the joint's temperature.

    d exp(-b (T - T0)) qd  =  d qd - b d (T - T0) qd + ...

The first term is viscous friction, an effect of its own; the second is this one. With both fitted, the rest of the
series is below 4 % of the viscous torque for 20 K and b up to 0.05 / K. T0 is 40 deg C, at which ISO 3448 states a
lubricant's viscosity. A joint whose temperature is not recorded counts as at T0, where the effect is zero.

Source: Reynolds' exponential law of viscosity; its use in robot joints by Carvalho Bittencourt, Wernholt,
    Sander-Tavallaey, Brogardh, "An Extended Friction Model to Capture Load and Temperature Effects in Robot Joints",
    IROS 2010.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import torch
from torch import Tensor

from torchrbd.effects.base import CoefficientPrior, JointEffect, Shape
from torchrbd.effects.signals import JointScale, JointState

REFERENCE_TEMPERATURE = 40.0
"""Temperature [deg C] at which the effect is zero."""


class ThermalViscosity(JointEffect):
    """tau += -s (T - T0) qd with s >= 0 and T0 = 40 deg C; s / d is the relative loss of viscosity per kelvin."""

    id = "thermal_viscosity"
    family = "friction"
    friction_part = "modulator"
    words = "viscous friction that falls with temperature"
    equation = "-s (T - 40 deg C) qd"
    shown_by = (
        "The same fast motion from cold to warm, with recorded temperature: the slope of torque over speed falls."
    )
    of_conditions = True
    curve_times = "speed"
    own_signals = ("qd",)
    of_drives = True
    units: ClassVar[Mapping[str, str]] = {"viscous_per_kelvin": "{tau} s/({q} K)"}
    drawn_over = "temperature"
    needs = "a channel temperature_<joint> that changes"
    prior = CoefficientPrior("Lubricants thin as they warm.", positive=(0,))
    export_note = (
        "MJCF has no temperature: add -s (T - 40) to the joint's damping at the temperature T that is simulated"
    )

    def shapes(self, scale: JointScale) -> tuple[Shape, ...]:
        """Return no shape if the temperature is not recorded or constant: the term is then viscous friction."""
        coldest, warmest = scale.temperature or (0.0, 0.0)
        return ({},) if warmest > coldest else ()

    def joint_features(self, state: JointState, shape: Shape) -> dict[str, Tensor]:
        T = state.temperature
        warmer = torch.zeros_like(state.qd) if T is None else T - REFERENCE_TEMPERATURE
        return {f"({REFERENCE_TEMPERATURE:.6g} - T) qd": -warmer * state.qd}

    def parameters(self, coefficients: Tensor, shape: Shape) -> dict[str, Tensor]:
        return {"viscous_per_kelvin": coefficients[0]}

    def coefficients(self, parameters: Mapping[str, float]) -> tuple[tuple[float, ...], Shape]:
        return (parameters["viscous_per_kelvin"],), {}

    def plausible(self, parameters: Mapping[str, float], scale: JointScale) -> bool:
        return parameters["viscous_per_kelvin"] >= 0
