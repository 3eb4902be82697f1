"""Torque saturation: beyond a limit the recorded torque and the one that acts grow at different rates.

    slope > 0    recorded is a current or a command, and the actuator gives less and less of it: iron saturates, a
                 limiter sets in
    slope = -1   recorded is clipped: a sensor or an amplifier's reading ends at the limit

A command far beyond a hard limit cannot be told from the motion, which knows the limit but not the command. The load is
the torque that the rigid body takes.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np
from torch import Tensor

from torchrbd.physics.base import Effect, Shape
from torchrbd.physics.signals import JointScale, Signals, Site


class TorqueSaturation(Effect):
    """tau += slope sign(load) max(0, |load| - limit) with slope >= -1."""

    id = "torque_saturation"
    words = "torque saturation"
    equation = "slope sign(load) max(0, |load| - limit)"
    units: ClassVar[Mapping[str, str]] = {"limit": "{tau}", "slope": "1"}
    complexity = 2
    uses_load = True
    # From a desktop arm's wrist to a large arm's shoulder [N m, N]: a scale does not say how large the load is.
    _LOWEST, _HIGHEST, _GRID_POINTS = 0.3, 300.0, 28

    def shapes(self, scale: JointScale) -> tuple[Shape, ...]:
        return tuple({"limit": float(v)} for v in np.geomspace(self._LOWEST, self._HIGHEST, self._GRID_POINTS))

    def features(self, signals: Signals, site: Site, shape: Shape) -> dict[str, Tensor]:
        load, limit = signals.load[site.joint], shape["limit"]
        return {f"load beyond {limit:.6g}": load - load.clamp(-limit, limit)}

    def parameters(self, coefficients: Tensor, shape: Shape) -> dict[str, Tensor]:
        return {"limit": coefficients.new_tensor(shape["limit"]), "slope": coefficients[0]}

    def coefficients(self, parameters: Mapping[str, float]) -> tuple[tuple[float, ...], Shape]:
        return (parameters["slope"],), {"limit": parameters["limit"]}

    def plausible(self, parameters: Mapping[str, float], scale: JointScale) -> bool:
        return parameters["limit"] > 0 and parameters["slope"] >= -1
