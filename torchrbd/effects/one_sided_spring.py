"""One-sided spring: something elastic that acts on one side only, such as a soft stop or a taut cable."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar

import numpy as np
from torch import Tensor

from torchrbd.effects.base import CoefficientPrior, JointEffect, Mjcf, Shape
from torchrbd.effects.signals import JointScale, JointState


class OneSidedSpring(JointEffect):
    """tau += k max(0, q - q_0) for side > 0, -k max(0, q_0 - q) for side < 0, with k >= 0: it always pushes back.

    k is the stiffness, q_0 the position of first contact.
    """

    id = "one_sided_spring"
    family = "spring"
    words = "one-sided spring (soft stop, taut cable)"
    equation = "side k max(0, side (q - q_0)), side = +-1"
    shown_by = "Slow sweeps to both ends of the range: torque rises beyond one position, on one side only."
    acts_on_link = True
    own_signals = ("q",)
    units: ClassVar[Mapping[str, str]] = {"contact_position": "{q}", "side": "1", "stiffness": "{tau}/{q}"}
    comes_and_goes = True
    drawn_over = "q"
    kinds: ClassVar[Mapping[str, Mapping[float, str]]] = {"side": {}}
    several = True
    prior = CoefficientPrior("A spring pushes back.", positive=(0,))
    export_note = "a fixed tendon over this joint alone, with coefficient one"
    # Fractions of the range in which the spring acts; above the largest it is a joint spring. The grid is geometric:
    # ramps look alike at equal ratios of their lengths.
    _SHORTEST, _LONGEST, _GRID_POINTS = 0.04, 0.8, 8
    _FAR = 1e3

    def shapes(self, scale: JointScale) -> tuple[Shape, ...]:
        span = scale.q_high - scale.q_low
        if span <= 0:
            return ()
        lengths = span * np.geomspace(self._SHORTEST, self._LONGEST, self._GRID_POINTS)
        upper = [{"contact_position": scale.q_high - float(v), "side": 1.0} for v in lengths]
        lower = [{"contact_position": scale.q_low + float(v), "side": -1.0} for v in lengths]
        return (*upper, *lower)

    def joint_features(self, state: JointState, shape: Shape) -> dict[str, Tensor]:
        contact, side = shape["contact_position"], math.copysign(1.0, shape["side"])
        label = f"{'max' if side > 0 else 'min'}(q{-contact:+.6g}, 0)"
        return {label: side * (side * (state.q - contact)).clamp_min(0.0)}

    def parameters(self, coefficients: Tensor, shape: Shape) -> dict[str, Tensor]:
        return {
            "contact_position": coefficients.new_tensor(shape["contact_position"]),
            "side": coefficients.new_tensor(shape["side"]),
            "stiffness": coefficients[0],
        }

    def coefficients(self, parameters: Mapping[str, float]) -> tuple[tuple[float, ...], Shape]:
        return (parameters["stiffness"],), {name: parameters[name] for name in ("contact_position", "side")}

    def plausible(self, parameters: Mapping[str, float], scale: JointScale) -> bool:
        return parameters["stiffness"] >= 0 and scale.q_low < parameters["contact_position"] < scale.q_high

    def mjcf(self, parameters: Mapping[str, float]) -> Mjcf:
        contact, far = parameters["contact_position"], math.copysign(self._FAR, parameters["side"])
        slack = tuple(sorted((contact - far, contact)))
        return {"fixed": {"stiffness": parameters["stiffness"], "springlength": slack}}

    def region(self, parameters: Mapping[str, float], scale: JointScale) -> tuple[float, float]:
        contact = parameters["contact_position"]
        return (contact, scale.q_high) if parameters["side"] > 0 else (scale.q_low, contact)
