"""Joint coupling: torque at a joint that depends on the position of another (tendon, cable bundle, parallel rod)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import permutations
from typing import ClassVar

import torch
from torch import Tensor

from torchrbd.effects.base import LEVEL, Curve, Effect, Mjcf, Shape
from torchrbd.effects.signals import JointScale, Signals
from torchrbd.effects.sites import Site, Window
from torchrbd.robot import RobotModel


class JointCoupling(Effect):
    """tau += k q_other + tau_0, with k of either sign; a spring between two joints acts on both, with equal k."""

    id = "joint_coupling"
    family = "transmission"
    words = "coupling to another joint's position"
    equation = "k q_other + tau_0"
    shown_by = "The other joint moves slowly while this one rests: this torque follows the other position."
    units: ClassVar[Mapping[str, str]] = {"stiffness": "{tau}/{q}", "offset": "{tau}"}
    export_note = "a fixed tendon over both joints with these coefficients; it acts on both, and adds abs(k) at each"

    def sites(self, robot: RobotModel, windows: Sequence[Window] = ()) -> tuple[Site, ...]:
        """Return all ordered pairs of joints."""
        return tuple(Site(joint, other=other) for joint, other in permutations(range(robot.n_dof), 2))

    def features(self, signals: Signals, site: Site, shape: Shape) -> dict[str, Tensor]:
        assert site.other is not None
        q = signals.q[site.other]
        return {f"q_{signals.robot.joint_names[site.other]}": q, LEVEL: torch.ones_like(q)}

    def parameters(self, coefficients: Tensor, shape: Shape) -> dict[str, Tensor]:
        return {"stiffness": coefficients[0], "offset": coefficients[1]}

    def coefficients(self, parameters: Mapping[str, float]) -> tuple[tuple[float, ...], Shape]:
        return (parameters["stiffness"], parameters["offset"]), {}

    def plausible(self, parameters: Mapping[str, float], scale: JointScale) -> bool:
        return True

    def mjcf(self, parameters: Mapping[str, float]) -> Mjcf:
        k, offset = parameters["stiffness"], parameters["offset"]
        rest = -offset / abs(k) if k else 0.0
        return {"fixed": {"stiffness": abs(k), "springlength": rest, "coef": (1.0, math.copysign(1.0, k))}}

    def curve(self, coefficients: Tensor, shape: Shape, scale: JointScale) -> Curve | None:
        state = scale.sweep("q")
        return state and Curve("q_other", state.q, coefficients[0] * state.q + coefficients[1])
