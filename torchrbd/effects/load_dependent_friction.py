"""Load-dependent friction: gears and bearings resist in proportion to the torque that they transmit.

A gear of efficiency eta needs |load| / eta to drive, and saves (1 - eta) |load| when driven. The losses 1 / eta - 1 and
1 - eta have the mean k. Half their difference is of second order in 1 - eta and acts as a torque gain. The load is the
rigid-body torque, never the measured one, which would explain itself.

Source: Hamon, Gautier, Garrec, Janot, "Dynamic Modeling and Identification of Joint Drive with Load-Dependent Friction
    Model", AIM 2010, with the same k in all four quadrants of torque and speed.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from torch import Tensor

from torchrbd.effects.base import CoefficientPrior, JointEffect, Shape
from torchrbd.effects.signals import JointScale, JointState


class LoadDependentFriction(JointEffect):
    """tau += k |load| sign(qd) with k >= 0; the load is the torque of the rigid body."""

    id = "load_dependent_friction"
    family = "friction"
    friction_part = "modulator"
    prevalence = "common"
    words = "load-dependent friction"
    equation = "k |load| sign(qd)"
    shown_by = (
        "Slow reversals in poses with small and with large gravity torque: the jump of friction grows with the load."
    )
    curve_times = "direction"
    own_signals = ("qd",)
    of_drives = True
    units: ClassVar[Mapping[str, str]] = {"load_friction": "1"}
    dissipative = True
    uses_load = True
    drawn_over = "load"
    prior = CoefficientPrior(
        "It resists motion; a gear loses some tenths of its load at most.", positive=(0,), std=(0.3,)
    )
    export_note = "MJCF has no friction that depends on the load"

    def joint_features(self, state: JointState, shape: Shape) -> dict[str, Tensor]:
        assert state.load is not None
        return {"|load| sign(qd)": state.load.abs() * state.direction()}

    def parameters(self, coefficients: Tensor, shape: Shape) -> dict[str, Tensor]:
        return {"load_friction": coefficients[0]}

    def coefficients(self, parameters: Mapping[str, float]) -> tuple[tuple[float, ...], Shape]:
        return (parameters["load_friction"],), {}

    def plausible(self, parameters: Mapping[str, float], scale: JointScale) -> bool:
        return parameters["load_friction"] >= 0
