"""Counterbalance: a spring, gas spring or hydraulic cylinder on a crank across the joint carries part of the weight.

Let a be the crank, b the distance of the cylinder's foot from the joint, and r = a / b. theta = q - q_0 is the angle
from the dead centre, where the cylinder is shortest. The law of cosines gives its length and lever arm:

    L = b l(theta),  l = sqrt(1 + r^2 - 2 r cos(theta)),  dL/dq = a sin(theta) / l

A force F = F_0 + k (L - L_0), positive in tension, adds F dL/dq to the torque that the actuator must supply. With k = 0
this is a cylinder at constant pressure or a gas spring; F_0 < 0 if it pushes. The first term alone is like gravity at a
level axis. The harmonics of the second term distinguish a cylinder from weight: at a crank ratio of .2 to .9 they are
about a tenth of its RMS over 3 rad, a thirtieth over 1.5 rad.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor

from torchrbd.effects.base import CoefficientPrior, JointEffect, Shape
from torchrbd.effects.signals import JointScale, JointState
from torchrbd.effects.sites import Site, Window
from torchrbd.robot import RobotModel


class Counterbalance(JointEffect):
    """tau += k a b sin(theta) + (F_0 - k L_0) a sin(theta) / l(theta), with theta = q - q_0 from the dead centre.

    a is the crank, b the distance of the cylinder's foot from the joint, r = a / b the crank ratio, 0 < r < 1. k >= 0
    is the stiffness, F_0 the force at length L_0. l = sqrt(1 + r^2 - 2 r cos(theta)) is the length in units of b.
    """

    id = "counterbalance"
    family = "spring"
    words = "counterbalance (spring, gas spring or cylinder on a crank)"
    equation = "(k a b + (F_0 - k L_0) a / l) sin(theta), theta = q - q_0, l = sqrt(1 + r^2 - 2 r cos(theta))"
    shown_by = "Slow sweeps through as much of a turn as the joint allows: torque is a distorted sine of the angle."
    acts_on_link = True
    own_signals = ("q",)
    units: ClassVar[Mapping[str, str]] = {
        "spring_torque": "{tau}",
        "force_torque": "{tau}",
        "dead_centre": "{q}",
        "crank_ratio": "1",
    }
    drawn_over = "q"
    prior = CoefficientPrior("The spring's stiffness is not negative; its preload may push or pull.", positive=(0,))
    export_note = "a spatial tendon from the crank to the cylinder's foot; motion does not identify where these are"
    # Centres are closer together within the range of motion: the nearer the crank ratio is to one, the sharper the bend
    # there.
    _CRANK_RATIOS, _STEP, _INSIDE = (0.45, 0.75), 0.4, 0.5
    # It carries weight: two torques of many times the load that cancel would model some other curvature.
    _MOST_LOADS = 5.0

    def sites(self, robot: RobotModel, windows: Sequence[Window] = ()) -> tuple[Site, ...]:
        """Return the revolute joints: a prismatic joint has no crank."""
        return tuple(Site(joint) for joint, slides in enumerate(robot.prismatic.tolist()) if not slides)

    def shapes(self, scale: JointScale) -> tuple[Shape, ...]:
        return tuple({"dead_centre": c, "crank_ratio": r} for r in self._CRANK_RATIOS for c in self._centres(scale, r))

    def _centres(self, scale: JointScale, ratio: float) -> list[float]:
        low, span, turn = scale.q_low, min(scale.q_high - scale.q_low, 2.0 * np.pi), 2.0 * np.pi
        step = min(self._STEP, self._INSIDE * (1.0 - ratio) / ratio**0.5)
        inside = np.linspace(low, low + span, round(span / step) + 1)
        outside = np.linspace(low + span, low + turn, round((turn - span) / self._STEP) + 1)
        centres = np.unique(np.concatenate((inside, outside)).round(9))[:-1]
        return (np.remainder(centres + np.pi, turn) - np.pi).tolist()

    def joint_features(self, state: JointState, shape: Shape) -> dict[str, Tensor]:
        centre, r = shape["dead_centre"], shape["crank_ratio"]
        theta = state.q - centre
        arm, length = torch.sin(theta), torch.sqrt(1.0 + r**2 - 2.0 * r * torch.cos(theta))
        return {f"sin(q{-centre:+.6g})": arm, f"sin(q{-centre:+.6g}) / l({r:.6g})": arm / length}

    def parameters(self, coefficients: Tensor, shape: Shape) -> dict[str, Tensor]:
        return {
            "spring_torque": coefficients[0],
            "force_torque": coefficients[1],
            "dead_centre": coefficients.new_tensor(shape["dead_centre"]),
            "crank_ratio": coefficients.new_tensor(shape["crank_ratio"]),
        }

    def coefficients(self, parameters: Mapping[str, float]) -> tuple[tuple[float, ...], Shape]:
        shape = {name: parameters[name] for name in ("dead_centre", "crank_ratio")}
        return (parameters["spring_torque"], parameters["force_torque"]), shape

    def plausible(self, parameters: Mapping[str, float], scale: JointScale) -> bool:
        spring, force = parameters["spring_torque"], abs(parameters["force_torque"])
        most = math.inf if scale.load_max is None else self._MOST_LOADS * scale.load_max
        return 0 <= spring <= most and force <= most and 0 < parameters["crank_ratio"] < 1
