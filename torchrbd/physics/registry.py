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

_EFFECTS: dict[str, Effect] = {}
_SEARCHED: set[str] = set()


def register(effect: Effect, *, searched: bool = True) -> Effect:
    """Make an effect known to the report and the export under its ``id``, and to the search if ``searched``."""
    _EFFECTS[effect.id] = effect
    if searched:
        _SEARCHED.add(effect.id)
    return effect


for _effect in (
    ViscousFriction(),
    CoulombFriction(),
    AsymmetricCoulombFriction(),
    StribeckFriction(),
    RotorInertia(),
    JointSpring(),
    TorqueOffset(),
):
    register(_effect)
# The shapes and sites of these are too many to have columns for all at once: they are fitted where they are told.
for _effect in (
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
    register(_effect, searched=False)


def effects() -> dict[str, Effect]:
    """Return all known effects by id."""
    return dict(_EFFECTS)


def searched_effects() -> dict[str, Effect]:
    """Return by id the effects that a diagnosis looks for unless it is told what to look for."""
    return {name: e for name, e in _EFFECTS.items() if name in _SEARCHED}


def effect(identifier: str) -> Effect:
    """Return one effect.

    Raises:
        OptionError: no effect has this id.
    """
    if identifier not in _EFFECTS:
        raise OptionError(f"unknown effect '{identifier}'; known: {', '.join(sorted(_EFFECTS))}")
    return _EFFECTS[identifier]
