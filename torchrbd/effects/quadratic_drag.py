"""Quadratic drag: resistance that grows with the square of speed (air, water, splashing oil).

Source: the drag equation F = 1/2 rho c_d A v^2 of fluid mechanics, with its factors in one coefficient.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from torch import Tensor

from torchrbd.effects.base import RESISTS, JointEffect, Mjcf, Shape
from torchrbd.effects.signals import JointScale, JointState


class QuadraticDrag(JointEffect):
    """tau += k qd |qd| with k >= 0."""

    id = "quadratic_drag"
    family = "friction"
    friction_part = "shape"
    words = "quadratic drag"
    equation = "k qd |qd|"
    shown_by = "Constant speeds up to the largest: torque grows with the square of speed."
    own_signals = ("qd",)
    of_drives = True
    units: ClassVar[Mapping[str, str]] = {"drag": "{tau} s^2/{q}^2"}
    dissipative = True
    prior = RESISTS
    export_note = "damping as a polynomial of speed needs a MuJoCo version that reads three numbers there"

    def joint_features(self, state: JointState, shape: Shape) -> dict[str, Tensor]:
        return {"qd |qd|": state.qd * state.qd.abs()}

    def parameters(self, coefficients: Tensor, shape: Shape) -> dict[str, Tensor]:
        return {"drag": coefficients[0]}

    def coefficients(self, parameters: Mapping[str, float]) -> tuple[tuple[float, ...], Shape]:
        return (parameters["drag"],), {}

    def plausible(self, parameters: Mapping[str, float], scale: JointScale) -> bool:
        return parameters["drag"] >= 0

    def mjcf(self, parameters: Mapping[str, float]) -> Mjcf:
        return {"joint": {"damping": (0.0, parameters["drag"], 0.0)}}
