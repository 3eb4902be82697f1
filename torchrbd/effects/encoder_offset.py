"""Encoder offset: the joint's zero is off; the recorded position is the true one plus a constant."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import ClassVar

import torch
from torch import Tensor

from torchrbd.effects.base import CoefficientPrior, Effect, Mjcf, Shape
from torchrbd.effects.displacements import about
from torchrbd.effects.placed import telling
from torchrbd.effects.signals import JointScale, Signals
from torchrbd.effects.sites import Site, Window
from torchrbd.robot import RobotModel


class EncoderOffset(Effect):
    """tau += tau_rigid(q - o) - tau_rigid(q): joint j is recorded as its true position plus o.

    The term is o (tau_rigid(q_j - about) - tau_rigid(q_j)) / about, exact for about = o. The shape parameter ``about``
    is computed from o. For a small offset the term is the derivative, -o d tau_rigid / dq_j.

    An offset at a first joint with a vertical axis changes no torque.
    """

    id = "encoder_offset"
    family = "gravity and geometry"
    prevalence = "common"
    words = "encoder offset"
    equation = "tau(q - o) - tau(q)"
    shown_by = "Slow motion through many arm poses: gravity torque is that of an angle that is shifted."
    own_signals = ("q",)
    units: ClassVar[Mapping[str, str]] = {"offset": "{q}"}
    comes_and_goes = True
    whole_robot = True
    uses_load = True
    follows = ("about",)
    prior = CoefficientPrior("Joint zeros are right to some hundredths of a rad or m.", std=(0.05,))
    _LARGEST = 0.2

    def sites(self, robot: RobotModel, windows: Sequence[Window] = ()) -> tuple[Site, ...]:
        return telling(self, robot, tuple(Site(joint) for joint in range(robot.n_dof)))

    def shapes(self, scale: JointScale) -> tuple[Shape, ...]:
        return (about(self, (0.0,)),)

    def agreeing(self, coefficients: Tensor, shape: Shape) -> Shape:
        return about(self, coefficients.tolist())

    def features(self, signals: Signals, site: Site, shape: Shape) -> dict[str, Tensor]:
        label, offset = f"-dtau/dq_{site.name(signals.robot)}", shape.get("about", 0.0)
        if not offset:
            return {label: -signals.load_slopes[0, :, site.joint]}
        shift = torch.zeros(len(signals.q), dtype=torch.float64)
        shift[site.joint] = offset
        there = replace(signals, q=signals.q - shift.to(signals.q).reshape(-1, *[1] * (signals.q.ndim - 1)))
        return {f"{label} about {offset:.6g}": (there.load - signals.load) / offset}

    def parameters(self, coefficients: Tensor, shape: Shape) -> dict[str, Tensor]:
        return {"offset": coefficients[0]}

    def coefficients(self, parameters: Mapping[str, float]) -> tuple[tuple[float, ...], Shape]:
        return (parameters["offset"],), about(self, (parameters["offset"],))

    def plausible(self, parameters: Mapping[str, float], scale: JointScale) -> bool:
        return abs(parameters["offset"]) <= self._LARGEST

    def mjcf(self, parameters: Mapping[str, float]) -> Mjcf:
        return {"joint": {"ref": parameters["offset"]}}
