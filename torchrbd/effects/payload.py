"""Payload: a load that a link carries for a time, such as a part in the gripper, or a tool in some recordings."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor

from torchrbd.effects.base import CoefficientPrior, Effect, Mjcf, Shape
from torchrbd.effects.placed import in_windows, moved
from torchrbd.effects.signals import JointScale, Signals
from torchrbd.effects.sites import Site, Window
from torchrbd.robot import PARAMETERS, RobotModel


class Payload(Effect):
    """tau += Y_link(q, qd, qdd) pi during a window of time; Y_link is the link's regressor, pi the load's parameters.

    pi holds the mass m, the first moment m c, and the inertia about the link's origin; c is the centre of mass in the
    link's frame. The inertia matters. Without it, a point mass 13 cm from the origin leaves 2 to 20 % of its torque
    unexplained, and the estimate of its centre is off by 3 to 9 %.

    A load that is always there is part of the link; so every site has a window. Where few joints move a link, some of
    the ten parameters change no torque and are not identifiable.
    """

    id = "payload"
    family = "inertia and load"
    prevalence = "common"
    # A tool or part is picked up, carried and put down.
    lasts_s = 10.0
    words = "payload"
    equation = "Y_link [m, m c, I]"
    shown_by = "The same motion with and without the load, slow and fast, in several poses of the wrist."
    acts_on_link = True
    units: ClassVar[Mapping[str, str]] = {
        "mass": "kg",
        **dict.fromkeys("xyz", "m"),
        **dict.fromkeys(PARAMETERS[4:], "kg m^2"),
    }
    whole_robot = True
    prior = CoefficientPrior(
        "Mass and moments of inertia are not negative, centre and radius of gyration are some decimetres.",
        positive=(0, 4, 6, 9),
        std=(1.0, *[0.2] * 3, *[0.06] * 6),
        of_any_size=True,
    )
    export_note = (
        "the inertial of a body without joints that is added to the link. MJCF cannot limit it to a window of time"
    )
    _FURTHEST_M = 1.0

    def sites(self, robot: RobotModel, windows: Sequence[Window] = ()) -> tuple[Site, ...]:
        return in_windows(moved(self, robot, tuple(Site(body=body) for body in range(robot.n_bodies))), windows)

    def features(self, signals: Signals, site: Site, shape: Shape) -> dict[str, Tensor]:
        assert site.body is not None
        labels = [f"{name} {site.name(signals.robot)} {site.window}" for name in PARAMETERS]
        inside = signals.inside(site.window)
        if not inside.any():
            return {label: torch.zeros_like(signals.q) for label in labels}
        first = len(PARAMETERS) * site.body
        columns = signals.regressor[..., first : first + len(PARAMETERS)].movedim((-1, -2), (0, 1))
        return dict(zip(labels, columns * inside, strict=True))

    def parameters(self, coefficients: Tensor, shape: Shape) -> dict[str, Tensor]:
        m, mc, inertia = coefficients[0], coefficients[1:4], coefficients[4:]
        # Without mass, the centre is far away but finite.
        divisor = m + 1e-12 * (m == 0)
        return dict(zip(self.units, (m, *(c / divisor for c in mc), *inertia), strict=True))

    def coefficients(self, parameters: Mapping[str, float]) -> tuple[tuple[float, ...], Shape]:
        m, x, y, z, *inertia = (parameters[name] for name in self.units)
        return (m, m * x, m * y, m * z, *inertia), {}

    def plausible(self, parameters: Mapping[str, float], scale: JointScale) -> bool:
        # Parameters that change no torque are NaN and count as plausible. Where the mass is NaN, the moments of inertia
        # must not be negative.
        far = any(abs(parameters[axis]) > self._FURTHEST_M for axis in "xyz")
        felt = ("Ixx", "Iyy", "Izz") if math.isnan(parameters["mass"]) else ("mass",)
        return not far and not any(parameters[name] < 0 for name in felt)

    def mjcf(self, parameters: Mapping[str, float]) -> Mjcf:
        m, *centre = (parameters[name] for name in ("mass", *"xyz"))
        c = np.array(centre)
        xx, xy, yy, xz, yz, zz = (parameters[name] for name in PARAMETERS[4:])
        about_origin = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        central = about_origin - m * (c @ c * np.eye(3) - np.outer(c, c))
        entries = tuple(float(central[at]) for at in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)))
        return {"inertial": {"mass": m, "pos": tuple(centre), "fullinertia": entries}}
