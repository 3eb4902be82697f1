"""Torque ripple: torque that repeats with position, from cogging magnets, gear teeth or a harmonic drive.

The order m is the number of cycles per turn of the joint. A motor behind a gear of ratio N turns N times per turn of
the joint. Its eccentricity has the order N, a harmonic drive's wave generator 2 N, the teeth of an output gear their
number. If N is an integer, all orders are integers.

Source: Tuttle, "Understanding and Modeling the Behavior of a Harmonic Drive Gear Transmission", MIT 1992, on the orders
    of a harmonic drive.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor

from torchrbd.effects.base import JointEffect, Mjcf, Shape
from torchrbd.effects.signals import JointScale, JointState


class TorqueRipple(JointEffect):
    """tau += A sin(m q + phase) with A >= 0 and m cycles per turn; linear in A cos(phase) and A sin(phase)."""

    id = "torque_ripple"
    family = "transmission"
    prevalence = "common"
    words = "torque ripple"
    equation = "A sin(m q + phase)"
    shown_by = "A slow constant speed over several periods: torque repeats with the angle."
    own_signals = ("q",)
    of_drives = True
    units: ClassVar[Mapping[str, str]] = {"amplitude": "{tau}", "phase": "rad", "order": "1/{q}"}
    drawn_over = "q"
    export_note = "<dcmotor> needs other constants too"
    # Integer orders, or steps of half a cycle over the range if that is coarser: closer orders look alike. Above them
    # only the orders of harmonic drives: faster ripple is mostly outside of the torque's band.
    _LARGEST_ORDER, _GEAR_ORDERS = 120.0, (160.0, 200.0)

    def shapes(self, scale: JointScale) -> tuple[Shape, ...]:
        span = scale.q_high - scale.q_low
        if span <= 0:
            return ()
        step = max(1.0, math.pi / span)
        lowest = step * math.ceil(2 * math.pi / span / step)
        grid = np.arange(lowest, self._LARGEST_ORDER, step).tolist()
        return tuple({"order": float(m)} for m in (*grid, *self._GEAR_ORDERS))

    def joint_features(self, state: JointState, shape: Shape) -> dict[str, Tensor]:
        order = shape["order"]
        return {f"{name}({order:.6g} q)": f(order * state.q) for name, f in (("sin", torch.sin), ("cos", torch.cos))}

    def parameters(self, coefficients: Tensor, shape: Shape) -> dict[str, Tensor]:
        a, b = coefficients
        return {
            "amplitude": torch.hypot(a, b),
            "phase": torch.atan2(b, a),
            "order": coefficients.new_tensor(shape["order"]),
        }

    def coefficients(self, parameters: Mapping[str, float]) -> tuple[tuple[float, ...], Shape]:
        size, phase = parameters["amplitude"], parameters["phase"]
        return (size * math.cos(phase), size * math.sin(phase)), {"order": parameters["order"]}

    def plausible(self, parameters: Mapping[str, float], scale: JointScale) -> bool:
        return parameters["order"] * (scale.q_high - scale.q_low) >= 2 * math.pi

    def mjcf(self, parameters: Mapping[str, float]) -> Mjcf:
        return {"dcmotor": {"cogging": (parameters["amplitude"], parameters["order"], parameters["phase"] + math.pi)}}
