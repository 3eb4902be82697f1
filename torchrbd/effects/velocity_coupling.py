"""Velocity coupling: viscous torque at a joint from the speed of another, as in a differential wrist.

If two motors drive q_1 + q_2 and q_1 - q_2 with different friction, the torque of each joint depends on the other's
speed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import permutations
from typing import ClassVar

from torch import Tensor

from torchrbd.effects.base import Curve, Effect, Mjcf, Shape
from torchrbd.effects.signals import JointScale, Signals
from torchrbd.effects.sites import Site, Window
from torchrbd.robot import RobotModel


class VelocityCoupling(Effect):
    """tau += d qd_other, with d of either sign; friction of a shared drive acts on both joints, with equal d."""

    id = "velocity_coupling"
    family = "transmission"
    words = "coupling to another joint's velocity"
    equation = "d qd_other"
    shown_by = "The other joint moves at several constant speeds: this torque follows the other velocity."
    other_signal = "qd"
    units: ClassVar[Mapping[str, str]] = {"viscous": "{tau} s/{q}"}
    export_note = "a fixed tendon over both joints with these coefficients; it acts on both, and adds abs(d) at each"

    def sites(self, robot: RobotModel, windows: Sequence[Window] = ()) -> tuple[Site, ...]:
        """Return all ordered pairs of joints."""
        return tuple(Site(joint, other=other) for joint, other in permutations(range(robot.n_dof), 2))

    def features(self, signals: Signals, site: Site, shape: Shape) -> dict[str, Tensor]:
        assert site.other is not None
        return {f"qd_{signals.robot.joint_names[site.other]}": signals.qd[site.other]}

    def parameters(self, coefficients: Tensor, shape: Shape) -> dict[str, Tensor]:
        return {"viscous": coefficients[0]}

    def coefficients(self, parameters: Mapping[str, float]) -> tuple[tuple[float, ...], Shape]:
        return (parameters["viscous"],), {}

    def plausible(self, parameters: Mapping[str, float], scale: JointScale) -> bool:
        return True

    def mjcf(self, parameters: Mapping[str, float]) -> Mjcf:
        d = parameters["viscous"]
        return {"fixed": {"damping": abs(d), "coef": (1.0, math.copysign(1.0, d))}}

    def curve(self, coefficients: Tensor, shape: Shape, scale: JointScale) -> Curve | None:
        state = scale.sweep("qd")
        return state and Curve("qd_other", state.qd, coefficients[0] * state.qd)
