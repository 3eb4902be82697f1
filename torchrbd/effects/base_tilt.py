"""Tilted base: gravity does not point in the direction that the robot description assumes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

import torch
from torch import Tensor

from torchrbd.effects.base import CoefficientPrior, Mjcf, Shape, ShowsBodies
from torchrbd.effects.displacements import about
from torchrbd.effects.mjcf import quaternion
from torchrbd.effects.placed import telling
from torchrbd.effects.signals import JointScale, Signals
from torchrbd.effects.sites import Site, Window
from torchrbd.robot import RobotModel


class BaseTilt(ShowsBodies):
    """tau += G(q, -theta x g'): the base is turned by the rotation vector theta = (tilt_x, tilt_y, 0), in its own axes.

    G(q, g) is the torque of gravity g, linear in g. In the axes of the tilted base, gravity is exp(-[theta]x) g. This
    equals g - theta x g' to second order, with g' = exp(-[theta]x / 2) g. The theta of g' is the shape parameter
    ``about``, computed from the coefficients; for a small tilt it is zero.

    A turn about gravity does not change the torque. If the assumed gravity is along x or y, the two tilts are about the
    next two axes in cyclic order.
    """

    id = "base_tilt"
    family = "gravity and geometry"
    prevalence = "common"
    words = "tilted base"
    equation = "dtau/dg (-theta x g)"
    shown_by = (
        "Slow motion with the first joint through a full turn: gravity torque changes with the first joint's angle."
    )
    acts_on_link = True
    units: ClassVar[Mapping[str, str]] = {"tilt_x": "rad", "tilt_y": "rad"}
    comes_and_goes = True
    whole_robot = True
    uses_load = True
    follows = ("about_x", "about_y")
    prior = CoefficientPrior("Bases are level to some hundredths of a rad.", std=(0.05, 0.05))
    export_note = "of a base that stands upright: about x and y where gravity is along z"
    _LARGEST_RAD = 0.2

    def sites(self, robot: RobotModel, windows: Sequence[Window] = ()) -> tuple[Site, ...]:
        return telling(self, robot, (Site(),))

    def shapes(self, scale: JointScale) -> tuple[Shape, ...]:
        return (about(self, (0.0, 0.0)),)

    def agreeing(self, coefficients: Tensor, shape: Shape) -> Shape:
        return about(self, coefficients.tolist())

    def features(self, signals: Signals, site: Site, shape: Shape) -> dict[str, Tensor]:
        q, robot = signals.q.movedim(0, -1), signals.robot
        still, pi = torch.zeros_like(q), None if signals.pi is None else signals.pi.to(q)
        tilts = [shape.get(name, 0.0) for name in self.follows]
        where = f" about {tilts[0]:.6g}, {tilts[1]:.6g}" if any(tilts) else ""
        return {
            f"dtau/d{name}{where}": robot.inverse_dynamics(q, still, still, pi, sideways).movedim(-1, 0)
            for name, sideways in zip(self.units, self._sideways(robot, tilts).to(q), strict=True)
        }

    def through_bodies(self, signals: Signals, coefficients: Tensor) -> Tensor:
        """A tilted base makes the first body's centre of mass identifiable, if that body turns about the vertical."""
        still = torch.zeros_like(signals.q)
        tilts = tuple(about(self, coefficients.tolist()).values())
        sideways = coefficients.to(still) @ self._sideways(signals.robot, tilts).to(still)
        return signals.robot.regressor_batch_last(signals.q, still, still, sideways)

    def _sideways(self, robot: RobotModel, tilts: Sequence[float]) -> Tensor:
        """Return -e x g' (2, 3) for the two tilt axes e; g' is gravity turned by half of ``tilts`` (2,)."""
        down = int(robot.gravity.abs().argmax())
        turns = torch.eye(3, dtype=robot.gravity.dtype)[[(down + 1) % 3, (down + 2) % 3]]
        half = -0.5 * torch.tensor(tilts, dtype=turns.dtype) @ turns
        cross = torch.linalg.cross(half.expand(3, 3), torch.eye(3, dtype=turns.dtype)).mT
        turned = torch.linalg.matrix_exp(cross).to(robot.gravity) @ robot.gravity
        return -torch.linalg.cross(turns.to(turned), turned.expand(2, 3))

    def parameters(self, coefficients: Tensor, shape: Shape) -> dict[str, Tensor]:
        return {"tilt_x": coefficients[0], "tilt_y": coefficients[1]}

    def coefficients(self, parameters: Mapping[str, float]) -> tuple[tuple[float, ...], Shape]:
        tilts = parameters["tilt_x"], parameters["tilt_y"]
        return tilts, about(self, tilts)

    def plausible(self, parameters: Mapping[str, float], scale: JointScale) -> bool:
        return max(map(abs, parameters.values())) <= self._LARGEST_RAD

    def mjcf(self, parameters: Mapping[str, float]) -> Mjcf:
        return {"body": {"quat": quaternion((parameters["tilt_x"], parameters["tilt_y"], 0.0))}}
