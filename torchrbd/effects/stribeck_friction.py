"""Stribeck friction: friction falls from static to Coulomb friction as speed builds up a lubricant film.

Source: Armstrong-Helouvry, Dupont, Canudas de Wit, "A survey of models, analysis tools and compensation methods for the
    control of machines with friction", Automatica 1994, eq. (9), with exponent 2 and without its viscous part, which is
    an effect of its own.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor

from torchrbd.effects.base import DIRECTION, CoefficientPrior, JointEffect, Mjcf, Shape
from torchrbd.effects.signals import JointScale, JointState


class StribeckFriction(JointEffect):
    """tau += sign(qd) (c + (s - c) exp(-(qd / v_s)^2)) with static friction s >= Coulomb friction c >= 0.

    v_s is the Stribeck speed: at a few times this speed, friction is close to c.
    """

    id = "stribeck_friction"
    family = "friction"
    friction_part = "shape"
    prevalence = "common"
    words = "Stribeck friction"
    equation = "sign(qd) (c + (s - c) exp(-(qd/v_s)^2))"
    shown_by = "Constant speeds from very slow to fast: torque falls, then rises as speed grows."
    baseline = ((0.0, 1.0, 0.0), (0.0, 0.0, 0.0))
    dry = True
    own_signals = ("qd",)
    of_drives = True
    units: ClassVar[Mapping[str, str]] = {"coulomb": "{tau}", "static": "{tau}", "stribeck_speed": "{q}/s"}
    comes_and_goes = True
    dissipative = True
    prior = CoefficientPrior("It resists motion, and more at rest than in motion.", positive=(0, 1))
    export_note = "frictionloss is friction in motion; the additional friction at rest needs <dcmotor lugre>"
    exported_in_part = True
    urdf_note = "friction is that in fast motion; the additional friction at low speed is left out"
    # Slower ones are hidden by the softened sign; faster ones are a curvature of the whole range.
    _SLOWEST_IN_REST_WIDTHS, _FASTEST_IN_SPEED_RANGE, _GRID_POINTS = 4.0, 0.4, 6

    def shapes(self, scale: JointScale) -> tuple[Shape, ...]:
        low, high = self._SLOWEST_IN_REST_WIDTHS * scale.rest_width, self._FASTEST_IN_SPEED_RANGE * scale.speed_max
        if low >= high:
            return ()
        return tuple({"stribeck_speed": float(v)} for v in np.geomspace(low, high, self._GRID_POINTS))

    def joint_features(self, state: JointState, shape: Shape) -> dict[str, Tensor]:
        direction, speed = state.direction(), shape["stribeck_speed"]
        bump = direction * torch.exp(-((state.qd / speed) ** 2))
        return {DIRECTION: direction, f"sign(qd) exp(-(qd/{speed:.6g})^2)": bump}

    def parameters(self, coefficients: Tensor, shape: Shape) -> dict[str, Tensor]:
        coulomb, extra = coefficients
        return {
            "coulomb": coulomb,
            "static": coulomb + extra,
            "stribeck_speed": coefficients.new_tensor(shape["stribeck_speed"]),
        }

    def coefficients(self, parameters: Mapping[str, float]) -> tuple[tuple[float, ...], Shape]:
        coulomb, static = parameters["coulomb"], parameters["static"]
        return (coulomb, static - coulomb), {"stribeck_speed": parameters["stribeck_speed"]}

    def plausible(self, parameters: Mapping[str, float], scale: JointScale) -> bool:
        return parameters["static"] >= parameters["coulomb"] >= 0

    def urdf_dynamics(self, parameters: Mapping[str, float]) -> dict[str, float]:
        return {"friction": parameters["coulomb"]}

    def mjcf(self, parameters: Mapping[str, float]) -> Mjcf:
        return {"joint": {"frictionloss": parameters["coulomb"]}}
