"""Rotor inertia (armature): the motor's own inertia at the joint, the gear ratio squared times that of the rotor."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from torch import Tensor

from torchrbd.effects.base import ACCELERATION, CoefficientPrior, JointEffect, Mjcf, Shape
from torchrbd.effects.signals import JointScale, JointState


class RotorInertia(JointEffect):
    """tau += I_r qdd with I_r >= 0. At the first joint no motion separates it from the inertia of the link."""

    id = "rotor_inertia"
    family = "inertia and load"
    prevalence = "common"
    words = "rotor inertia (armature)"
    equation = "I_r qdd"
    shown_by = (
        "Fast oscillations of the joint in several arm poses: one part of the inertia is the same in all of them."
    )
    plain_columns = (ACCELERATION,)
    of_rotor = True
    own_signals = ("qdd",)
    of_drives = True
    units: ClassVar[Mapping[str, str]] = {"rotor_inertia": "{tau} s^2/{q}"}
    drawn_over = "qdd"
    prior = CoefficientPrior("An inertia is not negative.", positive=(0,), may_be_none=True)

    def joint_features(self, state: JointState, shape: Shape) -> dict[str, Tensor]:
        return {ACCELERATION: state.qdd}

    def parameters(self, coefficients: Tensor, shape: Shape) -> dict[str, Tensor]:
        return {"rotor_inertia": coefficients[0]}

    def coefficients(self, parameters: Mapping[str, float]) -> tuple[tuple[float, ...], Shape]:
        return (parameters["rotor_inertia"],), {}

    def plausible(self, parameters: Mapping[str, float], scale: JointScale) -> bool:
        return parameters["rotor_inertia"] >= 0

    def mjcf(self, parameters: Mapping[str, float]) -> Mjcf:
        return {"joint": {"armature": parameters["rotor_inertia"]}}
