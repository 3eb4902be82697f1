"""Time-varying friction: Coulomb friction that settles as a joint warms up, or rises as a brake or a seal tightens.

Every recording starts cold, at its own time zero, and all settle at one rate: a first-order thermal model. If the
joint's temperature is recorded, ``ThermalViscosity`` is more informative.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor

from torchrbd.effects.base import DIRECTION, CoefficientPrior, JointEffect, Mjcf, Shape
from torchrbd.effects.signals import JointScale, JointState


class TimeVaryingFriction(JointEffect):
    """tau += (c_end + (c_start - c_end) exp(-t/T)) sign(qd), with c_end >= 0 and c_start >= 0.

    t is the time from the recording's start, T the time constant.
    """

    id = "time_varying_friction"
    family = "friction"
    friction_part = "modulator"
    prevalence = "common"
    words = "friction that changes with time"
    equation = "(c_end + (c_start - c_end) exp(-t/T)) sign(qd)"
    shown_by = (
        "The same motion, repeated from a cold start for several time constants: friction changes from cycle to cycle."
    )
    baseline = ((0.0, 1.0, 0.0), (0.0, 0.0, 0.0))
    of_conditions = True
    curve_times = "direction"
    own_signals = ("qd",)
    of_drives = True
    units: ClassVar[Mapping[str, str]] = {
        "coulomb_end": "{tau}",
        "coulomb_start": "{tau}",
        "time_constant": "s",
    }
    dissipative = True
    drawn_over = "t"
    prior = CoefficientPrior(
        "It resists motion; with time it may rise or fall. Grease takes seconds to settle, a joint minutes to warm up.",
        positive=(0,),
    )
    export_note = "frictionloss is the value that friction settles to; MJCF has no friction that changes with time"
    exported_in_part = True
    urdf_note = "friction is the value that it settles to; its change with time is left out"
    # From a grease film that settles [s] to the length of the longest recording: slower ones are straight lines in time
    # and look alike. In long recordings fractions of that.
    _FASTEST_S, _FASTEST, _GRID_POINTS, _PLAUSIBLE = 3.0, 0.03, 4, 10.0

    def shapes(self, scale: JointScale) -> tuple[Shape, ...]:
        fastest = max(self._FASTEST * scale.duration_s, self._FASTEST_S)
        grid = np.geomspace(fastest, max(scale.duration_s, fastest), self._GRID_POINTS)
        return tuple({"time_constant": float(v)} for v in np.unique(grid))

    def joint_features(self, state: JointState, shape: Shape) -> dict[str, Tensor]:
        direction, T = state.direction(), shape["time_constant"]
        decay = torch.exp(-state.times() / T).to(direction)
        return {DIRECTION: direction, f"sign(qd) exp(-t/{T:.6g})": direction * decay}

    def parameters(self, coefficients: Tensor, shape: Shape) -> dict[str, Tensor]:
        end, extra = coefficients
        return {
            "coulomb_end": end,
            "coulomb_start": end + extra,
            "time_constant": coefficients.new_tensor(shape["time_constant"]),
        }

    def coefficients(self, parameters: Mapping[str, float]) -> tuple[tuple[float, ...], Shape]:
        end, start = parameters["coulomb_end"], parameters["coulomb_start"]
        return (end, start - end), {"time_constant": parameters["time_constant"]}

    def plausible(self, parameters: Mapping[str, float], scale: JointScale) -> bool:
        friction = parameters["coulomb_end"], parameters["coulomb_start"]
        slowest = self._PLAUSIBLE * max(scale.duration_s, self._FASTEST_S)
        return min(friction) >= 0 and self._FASTEST_S <= parameters["time_constant"] <= slowest

    def urdf_dynamics(self, parameters: Mapping[str, float]) -> dict[str, float]:
        return {"friction": parameters["coulomb_end"]}

    def mjcf(self, parameters: Mapping[str, float]) -> Mjcf:
        return {"joint": {"frictionloss": parameters["coulomb_end"]}}
