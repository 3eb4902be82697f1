"""A joint whose zero is off: the recorded position is the true one plus a constant."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

from torch import Tensor

from torchrbd.effects.base import CoefficientPrior, Effect, Mjcf, Shape
from torchrbd.effects.placed import telling
from torchrbd.effects.signals import JointScale, Signals
from torchrbd.effects.sites import Site, Window
from torchrbd.robot import RobotModel


class EncoderOffset(Effect):
    """tau += -o d tau_rigid / d q_j: q_j is recorded as the true position plus o.

    First order in o: the error grows with o^2. A first joint whose axis is vertical cannot have one that shows.
    """

    id = "encoder_offset"
    family = "gravity and geometry"
    prevalence = "common"
    words = "encoder offset"
    equation = "-o dtau/dq"
    units: ClassVar[Mapping[str, str]] = {"offset": "{q}"}
    comes_and_goes = True
    whole_robot = True
    uses_load = True
    prior = CoefficientPrior("Joints are zeroed to some hundredths of a rad or m.", std=(0.05,))
    _LARGEST = 0.2

    def sites(self, robot: RobotModel, windows: Sequence[Window] = ()) -> tuple[Site, ...]:
        return telling(self, robot, tuple(Site(joint) for joint in range(robot.n_dof)))

    def features(self, signals: Signals, site: Site, shape: Shape) -> dict[str, Tensor]:
        return {f"-dtau/dq_{site.name(signals.robot)}": -signals.load_slopes[0, :, site.joint]}

    def parameters(self, coefficients: Tensor, shape: Shape) -> dict[str, Tensor]:
        return {"offset": coefficients[0]}

    def coefficients(self, parameters: Mapping[str, float]) -> tuple[tuple[float, ...], Shape]:
        return (parameters["offset"],), {}

    def plausible(self, parameters: Mapping[str, float], scale: JointScale) -> bool:
        return abs(parameters["offset"]) <= self._LARGEST

    def mjcf(self, parameters: Mapping[str, float]) -> Mjcf:
        return {"joint": {"ref": parameters["offset"]}}
