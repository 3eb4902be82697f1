"""Joint spring: a spring between a link and its parent, such as a bent cable bundle or a tight seal."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import torch
from torch import Tensor

from torchrbd.effects.base import LEVEL, CoefficientPrior, JointEffect, Mjcf, Shape
from torchrbd.effects.signals import JointScale, JointState


class JointSpring(JointEffect):
    """tau += k (q - q0) with k >= 0; linear in the stiffness k and in the torque at q = 0, which is -k q0."""

    id = "joint_spring"
    family = "spring"
    prevalence = "common"
    words = "joint spring"
    equation = "k (q - q0)"
    shown_by = (
        "Slow sweeps through the whole range in several arm poses: torque grows with the angle, whatever gravity does."
    )
    acts_on_link = True
    own_signals = ("q",)
    units: ClassVar[Mapping[str, str]] = {"stiffness": "{tau}/{q}", "rest_position": "{q}"}
    comes_and_goes = True
    drawn_over = "q"
    prior = CoefficientPrior("A spring pushes back, and rests within the range of the joint.", positive=(0,))
    export_note = "the springs of a joint are added: springref is the rest position of their sum"

    def joint_features(self, state: JointState, shape: Shape) -> dict[str, Tensor]:
        return {"q": state.q, LEVEL: torch.ones_like(state.q)}

    def parameters(self, coefficients: Tensor, shape: Shape) -> dict[str, Tensor]:
        return {"stiffness": coefficients[0], "rest_position": -coefficients[1] / coefficients[0]}

    def coefficients(self, parameters: Mapping[str, float]) -> tuple[tuple[float, ...], Shape]:
        stiffness = parameters["stiffness"]
        return (stiffness, -stiffness * parameters["rest_position"]), {}

    def plausible(self, parameters: Mapping[str, float], scale: JointScale) -> bool:
        low, high = scale.joint_range
        return parameters["stiffness"] >= 0 and low <= parameters["rest_position"] <= high

    def mjcf(self, parameters: Mapping[str, float]) -> Mjcf:
        return {"joint": {"stiffness": parameters["stiffness"], "springref": parameters["rest_position"]}}
