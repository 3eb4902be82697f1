"""Wrong geometry: a joint is not where the robot description puts it. No inertial parameters can compensate for that.

A link of another length, a tilted axis and a turned flange are all a joint with a wrong <origin>.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import ClassVar

import torch
from torch import Tensor

from torchrbd.effects.base import CoefficientPrior, Effect, Mjcf, Shape
from torchrbd.effects.displacements import about
from torchrbd.effects.mjcf import quaternion
from torchrbd.effects.placed import moved
from torchrbd.effects.signals import JointScale, Signals
from torchrbd.effects.sites import Site, Window, carrier
from torchrbd.robot import RobotModel, with_moved_origins


class GeometryError(Effect):
    """tau += sum_k e_k d tau_rigid / d e_k: the joint's origin is shifted by (x, y, z) and turned by (rx, ry, rz).

    All are in the parent link's axes, as in URDF's <origin>. The derivatives are taken at half the error, so the term
    is exact to second order. The shape parameters ``about`` hold that error; for a small one they are zero.

    Three cases are other effects or no effect. Turning a joint about its own axis is an encoder offset. Turning the
    first joint, on the base, is a tilted base; shifting it changes no torque. Shifting a joint along its axis is the
    same as shifting the next joint. Joints on the base are therefore not searched.
    """

    id = "geometry_error"
    family = "gravity and geometry"
    words = "wrong geometry (joint origin or axis)"
    equation = "dtau/d(x, y, z, rx, ry, rz)"
    shown_by = (
        "Slow and fast motion through many arm poses, best with a heavy load: no masses explain gravity and "
        "inertia at once."
    )
    acts_on_link = True
    moves_origin = True
    units: ClassVar[Mapping[str, str]] = {"x": "m", "y": "m", "z": "m", "rx": "rad", "ry": "rad", "rz": "rad"}
    whole_robot = True
    uses_load = True
    follows = tuple(f"about_{name}" for name in units)
    prior = CoefficientPrior(
        "Descriptions are right to some centimetres and hundredths of a rad.", std=(*[0.02] * 3, *[0.05] * 3)
    )
    export_note = "pos adds to that of the joint's body, quat turns it from the left"
    # The links of another size of the same machine differ by one or two decimetres.
    _FURTHEST_M, _LARGEST_RAD = 0.2, 0.2

    def sites(self, robot: RobotModel, windows: Sequence[Window] = ()) -> tuple[Site, ...]:
        return moved(
            self, robot, tuple(Site(joint) for joint in range(robot.n_dof) if carrier(robot, joint) is not None)
        )

    def shapes(self, scale: JointScale) -> tuple[Shape, ...]:
        return (about(self, [0.0] * len(self.units)),)

    def agreeing(self, coefficients: Tensor, shape: Shape) -> Shape:
        return about(self, coefficients.tolist())

    def features(self, signals: Signals, site: Site, shape: Shape) -> dict[str, Tensor]:
        assert site.joint is not None
        place, error = site.name(signals.robot), tuple(shape.get(name, 0.0) for name in self.follows)
        if any(error):
            signals = replace(signals, robot=_halfway(signals.robot, site.joint, error))
            place += f" about {', '.join(f'{value:.6g}' for value in error)}"
        slopes = signals.origin_slopes[..., site.joint, :]
        return {
            f"dtau/d{name} {place}": slope
            for name, slope in zip(self.units, slopes.movedim((-1, -2), (0, 1)), strict=True)
        }

    def parameters(self, coefficients: Tensor, shape: Shape) -> dict[str, Tensor]:
        return dict(zip(self.units, coefficients, strict=True))

    def coefficients(self, parameters: Mapping[str, float]) -> tuple[tuple[float, ...], Shape]:
        errors = tuple(parameters[name] for name in self.units)
        return errors, about(self, errors)

    def plausible(self, parameters: Mapping[str, float], scale: JointScale) -> bool:
        limits = {"m": self._FURTHEST_M, "rad": self._LARGEST_RAD}
        # A parameter that changes no torque is NaN and counts as plausible.
        return not any(abs(value) > limits[self.units[name]] for name, value in parameters.items())

    def mjcf(self, parameters: Mapping[str, float]) -> Mjcf:
        x, y, z, *turn = (parameters[name] for name in self.units)
        return {"body": {"pos": (x, y, z), "quat": quaternion(turn)}}


@lru_cache(maxsize=16)
def _halfway(robot: RobotModel, joint: int, error: tuple[float, ...]) -> RobotModel:
    """Return the robot with the origin of a joint moved by half of an error (6,) [m, rad]."""
    moves = torch.zeros(robot.n_dof, len(error), dtype=torch.float64)
    moves[joint] = 0.5 * torch.tensor(error, dtype=torch.float64)
    return with_moved_origins(robot, moves)
