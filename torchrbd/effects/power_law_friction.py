"""Power-law friction: resistance that grows with a power of speed other than 0 (Coulomb), 1 (viscous) and 2 (drag).

Exponents below 1: lubricated seals and bearings, whose film gets thicker as they run, and shear-thinning grease.
Exponents above 1: oil or grease that a gearbox churns.

Source: the Ostwald-de Waele power law of shear-thinning (a < 1) and shear-thickening (a > 1) fluids. For a < 1, |qd|^a
has no slope at rest, so it is softened like the sign of the velocity: |qd| is sqrt(qd^2 + rest_width^2). For a > 1 it
needs no softening. The exponents tried stay 3/8 away from Coulomb friction and 1/8 from drag, refinement included:
closer ones cannot be distinguished from these.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from torch import Tensor

from torchrbd.effects.base import RESISTS, JointEffect, Shape
from torchrbd.effects.signals import JointScale, JointState


class PowerLawFriction(JointEffect):
    """tau += k |qd|^a sign(qd) with k >= 0 and 0 < a < 2, a != 1; k is the torque at 1 rad/s or 1 m/s."""

    id = "power_law_friction"
    family = "friction"
    friction_part = "shape"
    prevalence = "common"
    words = "power-law friction"
    equation = "k |qd|^a sign(qd)"
    shown_by = "Constant speeds in equal ratios, from very slow to fast: torque is a straight line on logarithmic axes."
    own_signals = ("qd",)
    of_drives = True
    units: ClassVar[Mapping[str, str]] = {"friction": "{tau} (s/{q})^a", "exponent": "1"}
    dissipative = True
    prior = RESISTS
    export_note = "MJCF has polynomials of speed, no powers"
    _EXPONENTS = (0.5, 0.75, 1.25, 1.5, 1.75)

    def shapes(self, scale: JointScale) -> tuple[Shape, ...]:
        return tuple({"exponent": a} for a in self._EXPONENTS)

    def joint_features(self, state: JointState, shape: Shape) -> dict[str, Tensor]:
        a = shape["exponent"]
        if a > 1.0:
            resistance = state.qd.sign() * state.qd.abs() ** a
        else:
            resistance = state.qd * (state.qd**2 + state.rest_width**2) ** (0.5 * (a - 1.0))
        return {f"|qd|^{a:.6g} sign(qd)": resistance}

    def parameters(self, coefficients: Tensor, shape: Shape) -> dict[str, Tensor]:
        return {"friction": coefficients[0], "exponent": coefficients.new_tensor(shape["exponent"])}

    def coefficients(self, parameters: Mapping[str, float]) -> tuple[tuple[float, ...], Shape]:
        return (parameters["friction"],), {"exponent": parameters["exponent"]}

    def plausible(self, parameters: Mapping[str, float], scale: JointScale) -> bool:
        return parameters["friction"] >= 0 and 0 < parameters["exponent"] < 2 and parameters["exponent"] != 1
