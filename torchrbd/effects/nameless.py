"""Hypotheses that locate a residual and name no law: friction for a time, and a force at a point of a link."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

import torch
from torch import Tensor

from torchrbd.effects.base import CoefficientPrior, Effect, Shape
from torchrbd.effects.coulomb_friction import CoulombFriction
from torchrbd.effects.placed import in_windows, moved
from torchrbd.effects.signals import JointScale, Signals
from torchrbd.effects.sites import Site, Window
from torchrbd.parameters import PARAMETERS_PER_BODY
from torchrbd.robot import RobotModel

# The first of a body's parameters: its mass and first moments.
_MASS_AND_MOMENTS = 4


class FrictionForATime(CoulombFriction):
    """tau += c sign(qd) with c >= 0 during a window of time, such as of something that rubs."""

    id = "friction_for_a_time"
    prevalence = "rare"
    words = "friction for a time"

    def sites(self, robot: RobotModel, windows: Sequence[Window] = ()) -> tuple[Site, ...]:
        """Return every joint in every window."""
        return in_windows(super().sites(robot), windows)


class ForceAtPoint(Effect):
    """tau += -J_c(q)' f during a window of time: force f, in the base's axes, acts at a point c of the link.

    It is linear in f and in c f': twelve coefficients -(f, c_i f_k), of which six are free (``diagnosis/attack.py``).
    Column k is the torque that carries a unit mass whose weight is -1 N along the base's axis k.
    """

    id = "force_at_point"
    family = "external force"
    words = "force at a point of a link"
    equation = "-J_c(q)' f"
    acts_on_link = True
    whole_robot = True
    units: ClassVar[Mapping[str, str]] = {
        **{f"force_{axis}": "N" for axis in "xyz"},
        **{f"point_{i}_force_{k}": "N m" for i in "xyz" for k in "xyz"},
    }
    prior = CoefficientPrior(
        "Forces act some decimetres from a link's origin.", std=(*[1.0] * 3, *[0.3] * 9), of_any_size=True
    )

    def sites(self, robot: RobotModel, windows: Sequence[Window] = ()) -> tuple[Site, ...]:
        return in_windows(moved(self, robot, tuple(Site(body=body) for body in range(robot.n_bodies))), windows)

    def features(self, signals: Signals, site: Site, shape: Shape) -> dict[str, Tensor]:
        assert site.body is not None
        labels = [f"{component} at a point of {site.name(signals.robot)} {site.window}" for component in self.units]
        inside = signals.inside(site.window)
        if not inside.any():
            return {label: torch.zeros_like(signals.q) for label in labels}
        own = slice(PARAMETERS_PER_BODY * site.body, PARAMETERS_PER_BODY * site.body + _MASS_AND_MOMENTS)
        q, still = signals.q, torch.zeros_like(signals.q)
        axes = torch.eye(3, dtype=q.dtype)
        against = [signals.robot.regressor_batch_last(q, still, still, -axis)[:, own] for axis in axes]
        columns = torch.stack(against, dim=2).flatten(1, 2).movedim(1, 0)
        return dict(zip(labels, columns * inside, strict=True))

    def parameters(self, coefficients: Tensor, shape: Shape) -> dict[str, Tensor]:
        return dict(zip(self.units, -coefficients, strict=True))

    def coefficients(self, parameters: Mapping[str, float]) -> tuple[tuple[float, ...], Shape]:
        return tuple(-parameters[name] for name in self.units), {}

    def plausible(self, parameters: Mapping[str, float], scale: JointScale) -> bool:
        return True


FRICTION_FOR_A_TIME, FORCE_AT_POINT = FrictionForATime(), ForceAtPoint()
