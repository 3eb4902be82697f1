"""Presliding friction: before a joint slides, its friction is a spring that yields, so that it lags at reversals.

The bristles bend over the presliding distance d before they slip:

    dz/dt = qd / d (1 - z sign(qd)),  tau += c z,  -1 <= z <= 1

Between two samples the direction does not change, and z has an exact solution in the distance |dq| moved, z_k = s +
(z_(k-1) - s) exp(-|dq| / d) with s = sign(dq), whatever the speed. LuGre's bristle is the same z, with a Stribeck
curve in place of the constant c and damping of its rate beside it. For motion that is long against d the term is plain
Coulomb friction. What z was before the sequence is not known: it starts as if the joint had been sliding, which is
forgotten after a few d.

Source: Dahl, "A solid friction model", Aerospace Corp. TOR-0158(3107-18)-1, 1968, with exponent 1. LuGre: Canudas de
    Wit, Olsson, Astrom, Lischinsky, "A new model for control of systems with friction", IEEE TAC 1995.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor

from torchrbd.physics.base import Effect, Shape
from torchrbd.physics.recurrence import recurrence
from torchrbd.physics.signals import JointScale, Signals, Site


class PreslidingHysteresis(Effect):
    """tau += c z with c >= 0 and z the state of Dahl's model. It gives back what its spring holds: not dissipative."""

    id = "presliding_hysteresis"
    words = "presliding friction (Dahl, LuGre)"
    equation = "c z, dz/dt = qd/d (1 - z sign(qd))"
    units: ClassVar[Mapping[str, str]] = {"coulomb": "{tau}", "distance": "{q}"}
    complexity = 2
    # Parts of the range of motion. Shorter, it is Coulomb friction; longer, a spring that remembers beyond a tile.
    _SHORTEST, _LONGEST, _GRID_POINTS = 2e-3, 0.1, 6

    def shapes(self, scale: JointScale) -> tuple[Shape, ...]:
        span = scale.q_high - scale.q_low
        if span <= 0:
            return ()
        grid = np.geomspace(self._SHORTEST * span, self._LONGEST * span, self._GRID_POINTS)
        return tuple({"distance": float(d)} for d in grid)

    def features(self, signals: Signals, site: Site, shape: Shape) -> dict[str, Tensor]:
        signals.sequence()
        joint, d = signals.joint(site.joint), shape["distance"]
        moved = torch.diff(joint.q, dim=-1)
        exponent = -moved.abs() / d
        z = recurrence(joint.direction()[..., 0], torch.exp(exponent), -torch.sign(moved) * torch.expm1(exponent))
        return {f"dahl({d:.6g})": z}

    def parameters(self, coefficients: Tensor, shape: Shape) -> dict[str, Tensor]:
        return {"coulomb": coefficients[0], "distance": coefficients.new_tensor(shape["distance"])}

    def coefficients(self, parameters: Mapping[str, float]) -> tuple[tuple[float, ...], Shape]:
        return (parameters["coulomb"],), {"distance": parameters["distance"]}

    def plausible(self, parameters: Mapping[str, float], scale: JointScale) -> bool:
        return parameters["coulomb"] >= 0
