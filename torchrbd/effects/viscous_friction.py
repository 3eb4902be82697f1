"""Viscous friction: resistance in proportion to speed (lubricant, back-EMF in a shorted winding)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from torch import Tensor

from torchrbd.effects.base import FRICTION, SPEED, JointEffect, Mjcf, Shape
from torchrbd.effects.signals import JointScale, JointState


class ViscousFriction(JointEffect):
    """tau += d qd with d >= 0."""

    id = "viscous_friction"
    family = "friction"
    prevalence = "ubiquitous"
    words = "viscous friction"
    equation = "d qd"
    shown_by = "Constant speeds from slow to fast, in both directions: torque grows in proportion to speed."
    plain_columns = (SPEED,)
    baseline = ((1.0, 0.0, 0.0),)
    urdf_tag = "damping"
    own_signals = ("qd",)
    units: ClassVar[Mapping[str, str]] = {"viscous": "{tau} s/{q}"}
    comes_and_goes = True
    dissipative = True
    prior = FRICTION

    def joint_features(self, state: JointState, shape: Shape) -> dict[str, Tensor]:
        return {SPEED: state.qd}

    def parameters(self, coefficients: Tensor, shape: Shape) -> dict[str, Tensor]:
        return {"viscous": coefficients[0]}

    def coefficients(self, parameters: Mapping[str, float]) -> tuple[tuple[float, ...], Shape]:
        return (parameters["viscous"],), {}

    def plausible(self, parameters: Mapping[str, float], scale: JointScale) -> bool:
        return parameters["viscous"] >= 0

    def urdf_dynamics(self, parameters: Mapping[str, float]) -> dict[str, float]:
        return {"damping": parameters["viscous"]}

    def mjcf(self, parameters: Mapping[str, float]) -> Mjcf:
        return {"joint": {"damping": parameters["viscous"]}}
