"""A base that is not level: gravity does not pull along the axis that the robot description assumes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

import torch
from torch import Tensor

from torchrbd.effects.base import CoefficientPrior, Mjcf, Shape, ShowsBodies
from torchrbd.effects.mjcf import quaternion
from torchrbd.effects.placed import telling
from torchrbd.effects.signals import JointScale, Signals
from torchrbd.effects.sites import Site, Window
from torchrbd.robot import RobotModel


class BaseTilt(ShowsBodies):
    """tau += G(q, -theta x g): the base is turned by the rotation vector theta = (tilt_x, tilt_y, 0), in its own axes.

    G(q, g) is the torque that gravity g takes, linear in g. In the base's axes gravity becomes exp(-[theta]x) g, to
    first order g - theta x g: the error is theta / 2 of the effect, 2 % at .04 rad. A turn about gravity is not seen.
    If the assumed gravity lies along x or y, the two tilts are about the next two axes in cyclic order.
    """

    id = "base_tilt"
    family = "gravity and geometry"
    prevalence = "common"
    words = "tilted base"
    equation = "dtau/dg (-theta x g)"
    units: ClassVar[Mapping[str, str]] = {"tilt_x": "rad", "tilt_y": "rad"}
    comes_and_goes = True
    whole_robot = True
    uses_load = True
    prior = CoefficientPrior("Bases are level to some hundredths of a rad.", std=(0.05, 0.05))
    export_note = "of a base that stands upright: about x and y where gravity is along z"
    _LARGEST_RAD = 0.2

    def sites(self, robot: RobotModel, windows: Sequence[Window] = ()) -> tuple[Site, ...]:
        return telling(self, robot, (Site(),))

    def features(self, signals: Signals, site: Site, shape: Shape) -> dict[str, Tensor]:
        q, robot = signals.q.movedim(0, -1), signals.robot
        still, pi = torch.zeros_like(q), None if signals.pi is None else signals.pi.to(q)
        return {
            f"dtau/d{name}": robot.inverse_dynamics(q, still, still, pi, sideways).movedim(-1, 0)
            for name, sideways in zip(self.units, self._sideways(robot).to(q), strict=True)
        }

    def through_bodies(self, signals: Signals, coefficients: Tensor) -> Tensor:
        """A first body that turns about the vertical has its centre of mass told by a base that leans."""
        still = torch.zeros_like(signals.q)
        sideways = coefficients.to(still) @ self._sideways(signals.robot).to(still)
        return signals.robot.regressor_batch_last(signals.q, still, still, sideways)

    def _sideways(self, robot: RobotModel) -> Tensor:
        """Return -e x g for both axes e that a base can be tilted about, (2, 3)."""
        down = int(robot.gravity.abs().argmax())
        turns = torch.eye(3, dtype=robot.gravity.dtype)[[(down + 1) % 3, (down + 2) % 3]]
        return -torch.linalg.cross(turns, robot.gravity.expand(2, 3))

    def parameters(self, coefficients: Tensor, shape: Shape) -> dict[str, Tensor]:
        return {"tilt_x": coefficients[0], "tilt_y": coefficients[1]}

    def coefficients(self, parameters: Mapping[str, float]) -> tuple[tuple[float, ...], Shape]:
        return (parameters["tilt_x"], parameters["tilt_y"]), {}

    def plausible(self, parameters: Mapping[str, float], scale: JointScale) -> bool:
        return max(map(abs, parameters.values())) <= self._LARGEST_RAD

    def mjcf(self, parameters: Mapping[str, float]) -> Mjcf:
        return {"body": {"quat": quaternion((parameters["tilt_x"], parameters["tilt_y"], 0.0))}}
