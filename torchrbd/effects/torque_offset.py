"""Torque offset: a constant error of the torque sensor, or a constant load at the joint, always or for a time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

import torch
from torch import Tensor

from torchrbd.effects.base import LEVEL, CoefficientPrior, JointEffect, Mjcf, Shape
from torchrbd.effects.mjcf import affine
from torchrbd.effects.placed import in_windows
from torchrbd.effects.signals import JointScale, JointState
from torchrbd.effects.sites import Site, Window
from torchrbd.robot import RobotModel


class TorqueOffset(JointEffect):
    """tau += tau_0."""

    id = "torque_offset"
    family = "actuator and sensor"
    prevalence = "common"
    words = "constant torque offset"
    equation = "tau_0"
    shown_by = "Slow motion in both directions, with gravity torque of both signs: a constant torque remains."
    plain_columns = (LEVEL,)
    baseline = ((0.0, 0.0, 1.0),)
    units: ClassVar[Mapping[str, str]] = {"offset": "{tau}"}
    comes_and_goes = True
    drawn_over = "q"
    prior = CoefficientPrior("A sensor's zero is off by about a tenth of the joint's torque.", torque_part=0.1)

    def sites(self, robot: RobotModel, windows: Sequence[Window] = ()) -> tuple[Site, ...]:
        """Return every joint, always or in windows of time: brakes drag, cables pull, sensors are calibrated again."""
        return in_windows(super().sites(robot), windows) if windows else super().sites(robot)

    def joint_features(self, state: JointState, shape: Shape) -> dict[str, Tensor]:
        return {LEVEL: torch.ones_like(state.q)}

    def parameters(self, coefficients: Tensor, shape: Shape) -> dict[str, Tensor]:
        return {"offset": coefficients[0]}

    def coefficients(self, parameters: Mapping[str, float]) -> tuple[tuple[float, ...], Shape]:
        return (parameters["offset"],), {}

    def plausible(self, parameters: Mapping[str, float], scale: JointScale) -> bool:
        return True

    def mjcf(self, parameters: Mapping[str, float]) -> Mjcf:
        return {"general": affine(-parameters["offset"])}
