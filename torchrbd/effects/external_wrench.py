"""External force or moment: a constant wrench on a link while something touches it (contact, hose, spring balancer)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

import torch
from torch import Tensor

from torchrbd.effects.base import CoefficientPrior, Effect, Shape
from torchrbd.effects.placed import in_windows, moved
from torchrbd.effects.signals import JointScale, Signals
from torchrbd.effects.sites import Site, Window
from torchrbd.robot import RobotModel


class ExternalWrench(Effect):
    """tau += -J(q)' [f, n] during a window of time: force f and moment n act on the link at its origin.

    f and n are in the base's axes; J is the link's Jacobian. Where few joints move a link, some components of the
    wrench change no torque and are not identifiable.
    """

    id = "external_wrench"
    family = "external force"
    words = "external force or moment"
    equation = "-J(q)' [f, n]"
    shown_by = "The same motion with and without the contact: all joints before the link change their torque together."
    acts_on_link = True
    units: ClassVar[Mapping[str, str]] = {
        **{f"force_{axis}": "N" for axis in "xyz"},
        **{f"moment_{axis}": "N m" for axis in "xyz"},
    }
    prior = CoefficientPrior(
        "Forces act some decimetres from a link's origin.", std=(1.0, 1.0, 1.0, 0.3, 0.3, 0.3), of_any_size=True
    )
    whole_robot = True
    export_note = "a force is not part of a model: apply it in MuJoCo as xfrc_applied, at the body's centre of mass"

    def sites(self, robot: RobotModel, windows: Sequence[Window] = ()) -> tuple[Site, ...]:
        return in_windows(moved(self, robot, tuple(Site(body=body) for body in range(robot.n_bodies))), windows)

    def features(self, signals: Signals, site: Site, shape: Shape) -> dict[str, Tensor]:
        assert site.body is not None
        labels = [f"{component} {site.name(signals.robot)} {site.window}" for component in self.units]
        inside = signals.inside(site.window)
        if not inside.any():
            return {label: torch.zeros_like(signals.q) for label in labels}
        J = signals.robot.jacobian(signals.q.movedim(0, -1), site.body).movedim((-2, -1), (0, 1))
        return dict(zip(labels, -J * inside, strict=True))

    def parameters(self, coefficients: Tensor, shape: Shape) -> dict[str, Tensor]:
        return dict(zip(self.units, coefficients, strict=True))

    def coefficients(self, parameters: Mapping[str, float]) -> tuple[tuple[float, ...], Shape]:
        return tuple(parameters[name] for name in self.units), {}

    def plausible(self, parameters: Mapping[str, float], scale: JointScale) -> bool:
        return True
