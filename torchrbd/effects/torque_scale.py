"""Torque scale: a gain error of one joint's torque sensor, or a wrong torque constant or gear ratio.

The recorded torque is g times the acting torque. Friction is recorded with the same gain, and its fitted coefficients
absorb that, so the gain of the rigid-body torque remains. The feature is the predicted torque; the measured one would
explain itself. One gain of all joints cannot be distinguished from scaled inertial parameters. For a light last joint
this almost holds too: only the small torque that its link adds at the other joints separates the two.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from torch import Tensor

from torchrbd.effects.base import CoefficientPrior, JointEffect, Mjcf, Shape
from torchrbd.effects.signals import JointScale, JointState


class TorqueScale(JointEffect):
    """tau += (g - 1) load with gain g > 0; the load is the torque of the rigid body."""

    id = "torque_scale"
    family = "actuator and sensor"
    prevalence = "common"
    words = "gain error of the torque"
    equation = "(g - 1) load"
    shown_by = (
        "Motion with a known payload, or with masses that are trusted: gravity torque has the wrong size everywhere."
    )
    units: ClassVar[Mapping[str, str]] = {"gain": "1"}
    comes_and_goes = True
    uses_load = True
    drawn_over = "load"
    prior = CoefficientPrior("Sensors and torque constants are right to some tenths.", std=(0.3,))
    export_note = "friction was recorded with the same gain: divide the joint's friction by it"

    def joint_features(self, state: JointState, shape: Shape) -> dict[str, Tensor]:
        assert state.load is not None
        return {"load": state.load}

    def parameters(self, coefficients: Tensor, shape: Shape) -> dict[str, Tensor]:
        return {"gain": 1.0 + coefficients[0]}

    def coefficients(self, parameters: Mapping[str, float]) -> tuple[tuple[float, ...], Shape]:
        return (parameters["gain"] - 1.0,), {}

    def plausible(self, parameters: Mapping[str, float], scale: JointScale) -> bool:
        return parameters["gain"] > 0

    def mjcf(self, parameters: Mapping[str, float]) -> Mjcf:
        return {"general": {"gainprm": (1.0 / parameters["gain"],)}}
