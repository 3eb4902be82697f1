"""Cable drag: a cable or hose rubs on the arm within a range of positions and resists motion there."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor

from torchrbd.effects.base import RESISTS, JointEffect, Shape
from torchrbd.effects.signals import JointScale, JointState


class CableDrag(JointEffect):
    """tau += c window(q) sign(qd) with c >= 0. The window is 1 from start to end; its edges are a tenth of it wide."""

    id = "cable_drag"
    family = "friction"
    friction_part = "modulator"
    words = "cable drag over a range of positions"
    equation = "c window(q; start, end) sign(qd)"
    shown_by = "Slow sweeps in both directions through the whole range: friction is larger between two positions."
    curve_times = "direction"
    own_signals = ("q", "qd")
    units: ClassVar[Mapping[str, str]] = {"start": "{q}", "end": "{q}", "resistance": "{tau}"}
    comes_and_goes = True
    dissipative = True
    drawn_over = "q"
    prior = RESISTS
    export_note = "MJCF has no friction that depends on position"
    _EDGE = 0.1
    # Widths as fractions of the range; steps between windows in units of the narrower of window and remainder.
    _WIDTHS, _STEP = (0.15, 0.3, 0.6), 0.3

    def shapes(self, scale: JointScale) -> tuple[Shape, ...]:
        span = scale.q_high - scale.q_low
        if span <= 0:
            return ()
        return tuple(
            {"start": float(start), "end": float(start) + part * span}
            for part in self._WIDTHS
            for start in np.linspace(scale.q_low, scale.q_high - part * span, self._places(part))
        )

    def _places(self, part: float) -> int:
        return round((1 - part) / (self._STEP * min(part, 1 - part))) + 1

    def joint_features(self, state: JointState, shape: Shape) -> dict[str, Tensor]:
        start, end = shape["start"], shape["end"]
        edge = self._EDGE * (end - start)
        window = 0.5 * (torch.tanh((state.q - start) / edge) - torch.tanh((state.q - end) / edge))
        return {f"sign(qd) window(q; {start:.6g}, {end:.6g})": state.direction() * window}

    def parameters(self, coefficients: Tensor, shape: Shape) -> dict[str, Tensor]:
        return {
            "start": coefficients.new_tensor(shape["start"]),
            "end": coefficients.new_tensor(shape["end"]),
            "resistance": coefficients[0],
        }

    def coefficients(self, parameters: Mapping[str, float]) -> tuple[tuple[float, ...], Shape]:
        return (parameters["resistance"],), {name: parameters[name] for name in ("start", "end")}

    def plausible(self, parameters: Mapping[str, float], scale: JointScale) -> bool:
        start, end = parameters["start"], parameters["end"]
        return parameters["resistance"] >= 0 and start < end and start < scale.q_high and end > scale.q_low

    def region(self, parameters: Mapping[str, float], scale: JointScale) -> tuple[float, float]:
        return parameters["start"], parameters["end"]
