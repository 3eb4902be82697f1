"""Position-dependent friction: a sticky region (dented bearing, dry spot, cable that rubs), or one that is worn smooth.

The region has one of two profiles: a bump, or a range with edges.

Source: the bump is that of Stribeck friction, over position instead of speed.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor

from torchrbd.effects.base import DIRECTION, CoefficientPrior, JointEffect, Mjcf, Shape
from torchrbd.effects.signals import JointScale, JointState

BUMP, RANGE = 0.0, 1.0


class PositionDependentFriction(JointEffect):
    """tau += (c + (c_0 - c) g(q)) sign(qd), with c_0 >= 0 and c >= 0.

        bump:   g = exp(-((q - q_0) / w)^2)
        range:  g = 1/2 (tanh((q - q_0 + w) / e) - tanh((q - q_0 - w) / e)),   e = w / 5

    Friction is c_0 at the centre q_0, and c far from it, the joint's baseline Coulomb friction included. w is half the
    width of the region: there a bump has fallen to 37 %, and a range to 50 %.
    """

    id = "position_dependent_friction"
    family = "friction"
    friction_part = "modulator"
    words = "friction that depends on position"
    equation = "(c + (c_0 - c) g(q)) sign(qd), g = exp(-((q - q_0)/w)^2), or 1 from q_0 - w to q_0 + w"
    shown_by = "Slow sweeps in both directions through the whole range: friction is larger or smaller in a part of it."
    baseline = ((0.0, 1.0, 0.0), (0.0, 0.0, 0.0))
    curve_times = "direction"
    own_signals = ("q", "qd")
    units: ClassVar[Mapping[str, str]] = {
        "centre": "{q}",
        "width": "{q}",
        "profile": "1",
        "coulomb": "{tau}",
        "coulomb_at_centre": "{tau}",
    }
    kinds: ClassVar[Mapping[str, Mapping[float, str]]] = {"profile": {BUMP: "a bump", RANGE: "a range with edges"}}
    comes_and_goes = True
    dissipative = True
    drawn_over = "q"
    prior = CoefficientPrior("It resists motion; the region may be sticky or worn smooth.", positive=(0,))
    export_note = "frictionloss is that outside of the region; MJCF has no friction that depends on position"
    exported_in_part = True
    urdf_note = "friction is that outside of the region; the difference inside is left out"
    # As fractions of the range. Wider bumps are a curvature over all of it; wider ranges are all of it.
    _BUMPS, _RANGES = (0.08, 0.18, 0.4), (0.075, 0.15, 0.3)
    # Steps of a bump's centre in widths; of a range's in the narrower of the range and what is outside.
    _BUMP_STEP, _RANGE_STEP, _EDGE = 0.7, 0.3, 0.2

    def shapes(self, scale: JointScale) -> tuple[Shape, ...]:
        span = scale.q_high - scale.q_low
        if span <= 0:
            return ()
        return tuple(
            {"centre": scale.q_low + centre * span, "width": part * span, "profile": profile}
            for profile, part, centre in self._grid()
        )

    def _grid(self) -> Iterator[tuple[float, float, float]]:
        """Yield profile, width and centre, these in parts of the range."""
        for part in self._BUMPS:
            yield from ((BUMP, part, c) for c in np.linspace(0, 1, round(1 / (self._BUMP_STEP * part)) + 1).tolist())
        for part in self._RANGES:
            inside, outside = 2.0 * part, 1.0 - 2.0 * part
            steps = round(outside / (self._RANGE_STEP * min(inside, outside)))
            yield from ((RANGE, part, c) for c in np.linspace(part, 1.0 - part, steps + 1).tolist())

    def joint_features(self, state: JointState, shape: Shape) -> dict[str, Tensor]:
        centre, width, profile = shape["centre"], shape["width"], shape["profile"]
        direction, at = state.direction(), (state.q - centre) / width
        if profile == BUMP:
            name, inside = f"exp(-((q{-centre:+.6g})/{width:.6g})^2)", torch.exp(-at.square())
        else:
            name = f"inside(q; {centre:.6g} +- {width:.6g})"
            inside = 0.5 * (torch.tanh((at + 1.0) / self._EDGE) - torch.tanh((at - 1.0) / self._EDGE))
        return {DIRECTION: direction, f"sign(qd) {name}": direction * inside}

    def parameters(self, coefficients: Tensor, shape: Shape) -> dict[str, Tensor]:
        coulomb, extra = coefficients
        return {
            **{name: coefficients.new_tensor(shape[name]) for name in ("centre", "width", "profile")},
            "coulomb": coulomb,
            "coulomb_at_centre": coulomb + extra,
        }

    def coefficients(self, parameters: Mapping[str, float]) -> tuple[tuple[float, ...], Shape]:
        coulomb, at_centre = parameters["coulomb"], parameters["coulomb_at_centre"]
        return (coulomb, at_centre - coulomb), {name: parameters[name] for name in ("centre", "width", "profile")}

    def plausible(self, parameters: Mapping[str, float], scale: JointScale) -> bool:
        return (
            min(parameters["coulomb"], parameters["coulomb_at_centre"]) >= 0
            and scale.q_low <= parameters["centre"] <= scale.q_high
            and 0 < parameters["width"] <= scale.q_high - scale.q_low
        )

    def urdf_dynamics(self, parameters: Mapping[str, float]) -> dict[str, float]:
        return {"friction": parameters["coulomb"]}

    def mjcf(self, parameters: Mapping[str, float]) -> Mjcf:
        return {"joint": {"frictionloss": parameters["coulomb"]}}

    def region(self, parameters: Mapping[str, float], scale: JointScale) -> tuple[float, float]:
        centre, width = parameters["centre"], parameters["width"]
        return centre - width, centre + width
