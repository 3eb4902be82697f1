"""The list of known effects. A third party adds its own with ``register``."""

from __future__ import annotations

from torchrbd.errors import OptionError
from torchrbd.physics.actuator_lag import ActuatorLag
from torchrbd.physics.backlash import Backlash
from torchrbd.physics.base import Effect
from torchrbd.physics.base_tilt import BaseTilt
from torchrbd.physics.cable_drag import CableDrag
from torchrbd.physics.coulomb_friction import AsymmetricCoulombFriction, CoulombFriction
from torchrbd.physics.counterbalance import Counterbalance
from torchrbd.physics.encoder_offset import EncoderOffset
from torchrbd.physics.external_wrench import ExternalWrench
from torchrbd.physics.geometry_error import GeometryError
from torchrbd.physics.joint_coupling import JointCoupling
from torchrbd.physics.joint_elasticity import JointElasticity
from torchrbd.physics.joint_spring import JointSpring
from torchrbd.physics.load_dependent_friction import LoadDependentFriction
from torchrbd.physics.one_sided_spring import OneSidedSpring
from torchrbd.physics.payload import Payload
from torchrbd.physics.position_dependent_friction import PositionDependentFriction
from torchrbd.physics.power_law_friction import PowerLawFriction
from torchrbd.physics.presliding_hysteresis import PreslidingHysteresis
from torchrbd.physics.quadratic_drag import QuadraticDrag
from torchrbd.physics.rotor_inertia import RotorInertia
from torchrbd.physics.smooth_torque import HUM, SMOOTH
from torchrbd.physics.speed_dependent_loss import SpeedDependentLoss
from torchrbd.physics.stribeck_friction import StribeckFriction
from torchrbd.physics.thermal_viscosity import ThermalViscosity
from torchrbd.physics.time_delay import TimeDelay
from torchrbd.physics.time_varying_friction import TimeVaryingFriction
from torchrbd.physics.torque_offset import TorqueOffset
from torchrbd.physics.torque_ripple import TorqueRipple
from torchrbd.physics.torque_saturation import TorqueSaturation
from torchrbd.physics.torque_scale import TorqueScale
from torchrbd.physics.velocity_coupling import VelocityCoupling
from torchrbd.physics.viscous_friction import ViscousFriction

PLAIN = ("viscous_friction", "coulomb_friction", "torque_offset")
"""What is found on every robot."""
PLAIN_OR_UNEVEN = (*PLAIN, "asymmetric_coulomb_friction")

_EFFECTS: dict[str, Effect] = {}
# Functions that follow no law: models may have them, nobody looks for them by name.
_UNNAMED: dict[str, Effect] = {smooth.id: smooth for smooth in (*SMOOTH, HUM)}


def register(effect: Effect) -> Effect:
    """Make an effect known to the search, the report and the export under its ``id``."""
    _EFFECTS[effect.id] = effect
    return effect


for _effect in (
    ViscousFriction(),
    CoulombFriction(),
    AsymmetricCoulombFriction(),
    StribeckFriction(),
    RotorInertia(),
    JointSpring(),
    TorqueOffset(),
    QuadraticDrag(),
    PowerLawFriction(),
    LoadDependentFriction(),
    SpeedDependentLoss(),
    TimeVaryingFriction(),
    ThermalViscosity(),
    PositionDependentFriction(),
    CableDrag(),
    PreslidingHysteresis(),
    OneSidedSpring(),
    Counterbalance(),
    TorqueRipple(),
    TorqueScale(),
    TorqueSaturation(),
    JointCoupling(),
    VelocityCoupling(),
    Backlash(),
    JointElasticity(),
    TimeDelay(),
    ActuatorLag(),
    EncoderOffset(),
    GeometryError(),
    BaseTilt(),
    Payload(),
    ExternalWrench(),
):
    register(_effect)


def effects() -> dict[str, Effect]:
    """Return all known effects by id."""
    return dict(_EFFECTS)


def effect(identifier: str) -> Effect:
    """Return one effect.

    Raises:
        OptionError: no effect has this id.
    """
    if identifier in _UNNAMED:
        return _UNNAMED[identifier]
    if identifier not in _EFFECTS:
        raise OptionError(f"unknown effect '{identifier}'; known: {', '.join(sorted(_EFFECTS))}")
    return _EFFECTS[identifier]
