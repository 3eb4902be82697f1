"""Presliding friction: before a joint slides, its friction is a spring that yields, so it lags behind reversals.

The bristles bend over the presliding distance d before they slip:

    dz/dt = qd / d (1 - z sign(qd)),  tau += c z,  -1 <= z <= 1

Between two samples the direction is constant, and z has an exact solution in the distance |dq| moved, whatever the
speed: z_k = s + (z_(k-1) - s) exp(-|dq| / d) with s = sign(dq). LuGre's bristle is the same z; it replaces the constant
c by a Stribeck curve and adds damping in proportion to dz/dt. For motion much longer than d the term is Coulomb
friction.

The solution holds for the whole way between two turning points, so these are all that z needs of the past. Before a
recording z is unknown: it starts as if the joint had been sliding. After a few d this no longer matters.

Source: Dahl, "A solid friction model", Aerospace Corp. TOR-0158(3107-18)-1, 1968, with exponent 1. LuGre: Canudas de
    Wit, Olsson, Astrom, Lischinsky, "A new model for control of systems with friction", IEEE TAC 1995.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor

from torchrbd.effects.base import RESISTS, Curve, JointEffect, Mjcf, Shape
from torchrbd.effects.recurrence import recurrence
from torchrbd.effects.signals import JointScale, JointState


class PreslidingHysteresis(JointEffect):
    """tau += c z with c >= 0, where z is the state of Dahl's model: dz/dt = qd / d (1 - z sign(qd)), -1 <= z <= 1.

    d is the presliding distance. The bristles store energy and give it back, so the term is not dissipative at each
    instant.
    """

    id = "presliding_hysteresis"
    family = "friction"
    friction_part = "shape"
    prevalence = "common"
    words = "presliding friction (Dahl, LuGre)"
    equation = "c z, dz/dt = qd/d (1 - z sign(qd))"
    shown_by = "Oscillations of a few milliradians around rest: torque over position is a loop, not a jump."
    dry = True
    curve_times = "direction"
    own_signals = ("qd",)
    of_drives = True
    units: ClassVar[Mapping[str, str]] = {"coulomb": "{tau}", "distance": "{q}"}
    has_memory = True
    prior = RESISTS
    export_note = "<dcmotor> needs other constants too; frictionloss of the same size lacks the lag at reversals"
    exported_in_part = True
    urdf_note = "friction is that of sliding; how it builds up after a reversal is left out"
    # Fractions of the range of motion. Shorter ones are Coulomb friction; longer ones a spring that hardly slides.
    _SHORTEST, _LONGEST, _GRID_POINTS = 2e-3, 0.1, 4

    def shapes(self, scale: JointScale) -> tuple[Shape, ...]:
        span = scale.q_high - scale.q_low
        if span <= 0:
            return ()
        grid = np.geomspace(self._SHORTEST * span, self._LONGEST * span, self._GRID_POINTS)
        return tuple({"distance": float(d)} for d in grid)

    def joint_features(self, state: JointState, shape: Shape) -> dict[str, Tensor]:
        state.sequence()
        path = state.q if state.turned is None else torch.cat((state.turned, state.q))
        d, moved = shape["distance"], torch.diff(path, dim=-1)
        exponent = -moved.abs() / d
        first = state.direction()[..., 0] if state.turned is None else torch.sign(moved[0])
        z = recurrence(first, torch.exp(exponent), -torch.sign(moved) * torch.expm1(exponent))
        return {f"dahl({d:.6g})": z[..., -state.q.shape[-1] :]}

    def parameters(self, coefficients: Tensor, shape: Shape) -> dict[str, Tensor]:
        return {"coulomb": coefficients[0], "distance": coefficients.new_tensor(shape["distance"])}

    def coefficients(self, parameters: Mapping[str, float]) -> tuple[tuple[float, ...], Shape]:
        return (parameters["coulomb"],), {"distance": parameters["distance"]}

    def plausible(self, parameters: Mapping[str, float], scale: JointScale) -> bool:
        return parameters["coulomb"] >= 0 and parameters["distance"] > 0

    def urdf_dynamics(self, parameters: Mapping[str, float]) -> dict[str, float]:
        return {"friction": parameters["coulomb"]}

    def mjcf(self, parameters: Mapping[str, float]) -> Mjcf:
        coulomb, bristle = parameters["coulomb"], parameters["coulomb"] / parameters["distance"]
        return {"dcmotor": {"lugre": (bristle, 0.0, coulomb, coulomb, 1.0)}}

    def curve(self, coefficients: Tensor, shape: Shape, scale: JointScale) -> Curve | None:
        """Return the loop of an oscillation in the middle of the range, long enough to slide at both ends."""
        turn = torch.linspace(0.0, 3.0 * math.pi, 1500, dtype=torch.float64)
        q = 0.5 * (scale.q_low + scale.q_high) + 4.0 * shape["distance"] * turn.cos()
        (z,) = self.joint_features(JointState(q, -turn.sin(), -turn.cos(), scale.rest_width, t=turn), shape).values()
        return Curve("q", q[500:], coefficients[0] * z[500:])
