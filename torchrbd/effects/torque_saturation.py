"""Torque saturation: beyond a limit, the recorded torque and the acting torque grow at different rates.

    slope > 0    the recording is a current or a command, and the actuator gives less and less of it: iron saturates, a
                 limiter sets in
    slope = -1   the recording is clipped: a sensor or an amplifier's reading ends at the limit

Beyond a hard limit the motion shows the limit but not the command. The load is the torque that the actuator supplies to
the rigid body and to friction.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar

import numpy as np
from torch import Tensor

from torchrbd.effects.base import CoefficientPrior, JointEffect, Mjcf, Shape
from torchrbd.effects.signals import JointScale, JointState


class TorqueSaturation(JointEffect):
    """tau += slope sign(load) max(0, |load| - limit), slope >= -1; the load is the torque that the actuator supplies.

    A positive slope is an actuator that gives less than its command; slope -1 is a clipped reading.
    """

    id = "torque_saturation"
    family = "actuator and sensor"
    words = "torque saturation"
    equation = "slope sign(load) max(0, |load| - limit)"
    shown_by = "Fast motion with large loads: torque no longer follows the model beyond a limit."
    units: ClassVar[Mapping[str, str]] = {"limit": "{tau}", "slope": "1"}
    uses_load = True
    sees_friction = True
    drawn_over = "load"
    prior = CoefficientPrior("From a clipped reading to an actuator that gives half of its command.", std=(1.0,))
    export_note = "a hard limit, not a gradual one: of the actuator, or of the reading if the slope is negative"
    exported_in_part = True
    # As fractions of the largest load. Lower ones are a torque gain; higher ones are hardly ever reached.
    _LOWEST, _HIGHEST, _GRID_POINTS = 0.35, 0.88, 4
    # A clipped reading is at the bound of -1: noise puts its estimate beyond it half of the time.
    _LEAST_SLOPE = -1.1
    # For a joint with an unknown load: from a desktop arm's wrist to a large arm's shoulder [N m, N].
    _LEAST_LOAD, _MOST_LOAD, _MOST_POINTS = 0.3, 300.0, 28

    def shapes(self, scale: JointScale) -> tuple[Shape, ...]:
        if scale.load_max is None:
            grid = np.geomspace(self._LEAST_LOAD, self._MOST_LOAD, self._MOST_POINTS)
        else:
            grid = scale.load_max * np.linspace(self._LOWEST, self._HIGHEST, self._GRID_POINTS)
        return tuple({"limit": float(v)} for v in grid if v > 0)

    def joint_features(self, state: JointState, shape: Shape) -> dict[str, Tensor]:
        limit, load = shape["limit"], state.supplied
        return {f"load beyond {limit:.6g}": load - load.clamp(-limit, limit)}

    def parameters(self, coefficients: Tensor, shape: Shape) -> dict[str, Tensor]:
        return {"limit": coefficients.new_tensor(shape["limit"]), "slope": coefficients[0]}

    def coefficients(self, parameters: Mapping[str, float]) -> tuple[tuple[float, ...], Shape]:
        return (parameters["slope"],), {"limit": parameters["limit"]}

    def plausible(self, parameters: Mapping[str, float], scale: JointScale) -> bool:
        most = math.inf if scale.load_max is None else scale.load_max
        return 0 < parameters["limit"] < most and parameters["slope"] >= self._LEAST_SLOPE

    def mjcf(self, parameters: Mapping[str, float]) -> Mjcf:
        limit = parameters["limit"]
        if parameters["slope"] < 0:
            return {"actuatorfrc": {"cutoff": limit}}
        return {"general": {"forcerange": (-limit, limit)}}
