"""All concealed effects by id."""

from __future__ import annotations

from collections.abc import Mapping

from .contract import Effect
from .friction import (
    AsymmetricCoulomb,
    CableDrag,
    Coulomb,
    LoadDependent,
    PositionDependent,
    Stribeck,
    TimeVarying,
)
from .joint_torques import (
    Counterbalance,
    JointCoupling,
    JointSpring,
    OneSidedSpring,
    Presliding,
    TorqueRipple,
    VelocityCoupling,
)
from .sensors import EncoderOffset, TimeDelay, TorqueOffset, TorqueSaturation, TorqueScale
from .transmission import ActuatorLag, Backlash, DeadZone, JointElasticity
from .unnamed import FrictionByOther, OneWayDamper, RandomWalk, TorqueBump, TorqueHum, VelocityProduct
from .viscosity import PowerLaw, QuadraticDrag, SpeedDependentLoss, ThermalViscosity, Viscous
from .whole_robot import BaseTilt, ExternalWrench, GeometryError, Payload, RotorInertia

Kinds = Mapping[str, type[Effect]]


def _by_id(*kinds: type[Effect]) -> Kinds:
    return {kind.id: kind for kind in kinds}


NAMED: Kinds = _by_id(
    Viscous,
    Coulomb,
    AsymmetricCoulomb,
    Stribeck,
    QuadraticDrag,
    PowerLaw,
    LoadDependent,
    SpeedDependentLoss,
    TimeVarying,
    ThermalViscosity,
    PositionDependent,
    CableDrag,
    Presliding,
    RotorInertia,
    JointSpring,
    OneSidedSpring,
    Counterbalance,
    TorqueRipple,
    JointCoupling,
    VelocityCoupling,
    Backlash,
    JointElasticity,
    Payload,
    ExternalWrench,
    BaseTilt,
    GeometryError,
    TorqueOffset,
    TorqueScale,
    TorqueSaturation,
    DeadZone,
    TimeDelay,
    ActuatorLag,
    EncoderOffset,
)
OUTSIDE: Kinds = _by_id(TorqueBump, VelocityProduct, TorqueHum, FrictionByOther, RandomWalk, OneWayDamper)
EFFECTS: Kinds = {**NAMED, **OUTSIDE}
