"""Position-dependent friction: a sticky region (dented bearing, tight gear mesh, dry spot), or one that is worn smooth.

Source: Stribeck friction's bump, as a function of position instead of speed.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor

from torchrbd.effects.base import DIRECTION, CoefficientPrior, JointEffect, Mjcf, Shape
from torchrbd.effects.signals import JointScale, JointState


class PositionDependentFriction(JointEffect):
    """tau += (c + (c_0 - c) exp(-((q - q_0) / w)^2)) sign(qd), with c_0 >= 0 and c >= 0.

    Friction is c_0 at the centre q_0 and c far from it; w is the width of the region.
    """

    id = "position_dependent_friction"
    family = "friction"
    friction_part = "modulator"
    words = "friction that depends on position"
    equation = "(c + (c_0 - c) exp(-((q - q_0)/w)^2)) sign(qd)"
    shown_by = "Slow reversals through the whole range: friction is larger or smaller around one position."
    baseline = ((0.0, 1.0, 0.0), (0.0, 0.0, 0.0))
    curve_times = "direction"
    own_signals = ("q", "qd")
    units: ClassVar[Mapping[str, str]] = {
        "centre": "{q}",
        "width": "{q}",
        "coulomb": "{tau}",
        "coulomb_at_centre": "{tau}",
    }
    comes_and_goes = True
    dissipative = True
    drawn_over = "q"
    prior = CoefficientPrior("It resists motion; the region may be sticky or worn smooth.", positive=(0,))
    export_note = "frictionloss is that outside of the region; MJCF has no friction that depends on position"
    exported_in_part = True
    urdf_note = "friction is that outside of the region; the difference inside is left out"
    # Widths as fractions of the range (wider ones are a curvature over all of it); steps of the centre in widths.
    _WIDTHS, _STEP = (0.08, 0.18, 0.4), 0.7

    def shapes(self, scale: JointScale) -> tuple[Shape, ...]:
        span = scale.q_high - scale.q_low
        if span <= 0:
            return ()
        return tuple(
            {"centre": float(centre), "width": part * span}
            for part in self._WIDTHS
            for centre in np.linspace(scale.q_low, scale.q_high, round(1 / (self._STEP * part)) + 1)
        )

    def joint_features(self, state: JointState, shape: Shape) -> dict[str, Tensor]:
        centre, width = shape["centre"], shape["width"]
        direction = state.direction()
        bump = direction * torch.exp(-(((state.q - centre) / width) ** 2))
        return {DIRECTION: direction, f"sign(qd) exp(-((q{-centre:+.6g})/{width:.6g})^2)": bump}

    def parameters(self, coefficients: Tensor, shape: Shape) -> dict[str, Tensor]:
        coulomb, extra = coefficients
        return {
            "centre": coefficients.new_tensor(shape["centre"]),
            "width": coefficients.new_tensor(shape["width"]),
            "coulomb": coulomb,
            "coulomb_at_centre": coulomb + extra,
        }

    def coefficients(self, parameters: Mapping[str, float]) -> tuple[tuple[float, ...], Shape]:
        coulomb, at_centre = parameters["coulomb"], parameters["coulomb_at_centre"]
        return (coulomb, at_centre - coulomb), {name: parameters[name] for name in ("centre", "width")}

    def plausible(self, parameters: Mapping[str, float], scale: JointScale) -> bool:
        return (
            min(parameters["coulomb"], parameters["coulomb_at_centre"]) >= 0
            and scale.q_low <= parameters["centre"] <= scale.q_high
            and 0 < parameters["width"] <= scale.q_high - scale.q_low
        )

    def urdf_dynamics(self, parameters: Mapping[str, float]) -> dict[str, float]:
        return {"friction": parameters["coulomb"]}

    def mjcf(self, parameters: Mapping[str, float]) -> Mjcf:
        return {"joint": {"frictionloss": parameters["coulomb"]}}

    def region(self, parameters: Mapping[str, float], scale: JointScale) -> tuple[float, float]:
        centre, width = parameters["centre"], parameters["width"]
        return centre - width, centre + width
