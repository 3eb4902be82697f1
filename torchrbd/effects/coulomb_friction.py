"""Coulomb friction: a constant resistance against motion, the same or different in the two directions.

Different directions: with s = sign(qd), c_plus max(s, 0) + c_minus min(s, 0). Away from rest these are the same torques
as one symmetric coefficient plus a constant offset. Motion alone cannot distinguish the two.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from torch import Tensor

from torchrbd.effects.base import DIRECTION, FRICTION, UNEVENNESS, CoefficientPrior, JointEffect, Mjcf, Shape
from torchrbd.effects.mjcf import affine
from torchrbd.effects.signals import JointScale, JointState


class CoulombFriction(JointEffect):
    """tau += c sign(qd) with c >= 0."""

    id = "coulomb_friction"
    family = "friction"
    prevalence = "ubiquitous"
    words = "Coulomb friction"
    equation = "c sign(qd)"
    shown_by = "Slow motion with many reversals: torque jumps where the velocity changes sign."
    plain_columns = (DIRECTION,)
    baseline = ((0.0, 1.0, 0.0),)
    dry = True
    urdf_tag = "friction"
    own_signals = ("qd",)
    units: ClassVar[Mapping[str, str]] = {"coulomb": "{tau}"}
    comes_and_goes = True
    dissipative = True
    prior = FRICTION

    def joint_features(self, state: JointState, shape: Shape) -> dict[str, Tensor]:
        return {DIRECTION: state.direction()}

    def parameters(self, coefficients: Tensor, shape: Shape) -> dict[str, Tensor]:
        return {"coulomb": coefficients[0]}

    def coefficients(self, parameters: Mapping[str, float]) -> tuple[tuple[float, ...], Shape]:
        return (parameters["coulomb"],), {}

    def plausible(self, parameters: Mapping[str, float], scale: JointScale) -> bool:
        return parameters["coulomb"] >= 0

    def urdf_dynamics(self, parameters: Mapping[str, float]) -> dict[str, float]:
        return {"friction": parameters["coulomb"]}

    def mjcf(self, parameters: Mapping[str, float]) -> Mjcf:
        return {"joint": {"frictionloss": parameters["coulomb"]}}


class AsymmetricCoulombFriction(JointEffect):
    """tau += c_plus for qd > 0, -c_minus for qd < 0, both >= 0.

    Half of their sum resists motion; half of their difference is a constant torque. The part that resists shares its
    column with every other friction that contains Coulomb friction.
    """

    id = "asymmetric_coulomb_friction"
    family = "friction"
    prevalence = "ubiquitous"
    words = "direction-dependent Coulomb friction"
    equation = "c_plus if qd > 0, -c_minus if qd < 0"
    shown_by = (
        "Slow motion in both directions, and rests: the friction of the two directions differs, and no "
        "torque remains at rest."
    )
    plain_columns = (DIRECTION, UNEVENNESS)
    baseline = ((0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    dry = True
    own_signals = ("qd",)
    units: ClassVar[Mapping[str, str]] = {"coulomb_plus": "{tau}", "coulomb_minus": "{tau}"}
    comes_and_goes = True
    dissipative = True
    prior = CoefficientPrior(
        "It resists motion in both directions, with a torque no larger than the joint's.",
        sums=((1.0, 1.0), (1.0, -1.0)),
        may_be_none=True,
    )
    export_note = "frictionloss is the mean of both directions; half their difference is a torque of the actuator"
    urdf_note = "friction is the mean of both directions; the difference between them is left out"

    def joint_features(self, state: JointState, shape: Shape) -> dict[str, Tensor]:
        direction = state.direction()
        return {DIRECTION: direction, UNEVENNESS: direction.abs()}

    def parameters(self, coefficients: Tensor, shape: Shape) -> dict[str, Tensor]:
        mean, half = coefficients
        return {"coulomb_plus": mean + half, "coulomb_minus": mean - half}

    def coefficients(self, parameters: Mapping[str, float]) -> tuple[tuple[float, ...], Shape]:
        plus, minus = parameters["coulomb_plus"], parameters["coulomb_minus"]
        return (0.5 * (plus + minus), 0.5 * (plus - minus)), {}

    def plausible(self, parameters: Mapping[str, float], scale: JointScale) -> bool:
        return parameters["coulomb_plus"] >= 0 and parameters["coulomb_minus"] >= 0

    def urdf_dynamics(self, parameters: Mapping[str, float]) -> dict[str, float]:
        return {"friction": 0.5 * (parameters["coulomb_plus"] + parameters["coulomb_minus"])}

    def mjcf(self, parameters: Mapping[str, float]) -> Mjcf:
        plus, minus = parameters["coulomb_plus"], parameters["coulomb_minus"]
        return {"joint": {"frictionloss": 0.5 * (plus + minus)}, "general": affine(-0.5 * (plus - minus))}
