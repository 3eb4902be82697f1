"""Speed-dependent torque loss: the efficiency of a gear falls with speed, so it loses a part of the load as it turns.

Tooth and cam contacts lose torque in proportion to the load and, through the lubricant, to the speed. The loss opposes
motion whether the gear drives or is driven. The load is the torque of the rigid body.

Source: efficiency charts of gear makers, in which the loss at one load grows with speed; taken as a straight line.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from torch import Tensor

from torchrbd.effects.base import RESISTS, JointEffect, Shape
from torchrbd.effects.signals import JointScale, JointState


class SpeedDependentLoss(JointEffect):
    """tau += k |load| qd with k >= 0: viscous friction in proportion to the load."""

    id = "speed_dependent_loss"
    family = "friction"
    friction_part = "modulator"
    words = "torque loss that grows with speed and load"
    equation = "k |load| qd"
    shown_by = (
        "Constant speeds in poses with small and with large load: the slope of torque over speed grows with the load."
    )
    own_signals = ("qd",)
    of_drives = True
    units: ClassVar[Mapping[str, str]] = {"loss": "s/{q}"}
    dissipative = True
    uses_load = True
    prior = RESISTS
    export_note = "MJCF has no damping that depends on the load"

    def joint_features(self, state: JointState, shape: Shape) -> dict[str, Tensor]:
        assert state.load is not None
        return {"|load| qd": state.load.abs() * state.qd}

    def parameters(self, coefficients: Tensor, shape: Shape) -> dict[str, Tensor]:
        return {"loss": coefficients[0]}

    def coefficients(self, parameters: Mapping[str, float]) -> tuple[tuple[float, ...], Shape]:
        return (parameters["loss"],), {}

    def plausible(self, parameters: Mapping[str, float], scale: JointScale) -> bool:
        return parameters["loss"] >= 0
