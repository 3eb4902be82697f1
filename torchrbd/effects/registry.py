"""The registry of effects. Add your own with ``register``."""

from __future__ import annotations

from torchrbd.effects.actuator_lag import ActuatorLag
from torchrbd.effects.backlash import Backlash
from torchrbd.effects.base import Effect
from torchrbd.effects.base_tilt import BaseTilt
from torchrbd.effects.coulomb_friction import AsymmetricCoulombFriction, CoulombFriction
from torchrbd.effects.counterbalance import Counterbalance
from torchrbd.effects.coupled_motor import CoupledMotor
from torchrbd.effects.encoder_offset import EncoderOffset
from torchrbd.effects.external_wrench import ExternalWrench
from torchrbd.effects.geometry_error import GeometryError
from torchrbd.effects.joint_coupling import JointCoupling
from torchrbd.effects.joint_elasticity import JointElasticity
from torchrbd.effects.joint_spring import JointSpring
from torchrbd.effects.load_dependent_friction import LoadDependentFriction
from torchrbd.effects.one_sided_spring import OneSidedSpring
from torchrbd.effects.payload import Payload
from torchrbd.effects.position_dependent_friction import PositionDependentFriction
from torchrbd.effects.power_law_friction import PowerLawFriction
from torchrbd.effects.presliding_hysteresis import PreslidingHysteresis
from torchrbd.effects.quadratic_drag import QuadraticDrag
from torchrbd.effects.rotor_inertia import RotorInertia
from torchrbd.effects.smooth_torque import HUM, SMOOTH
from torchrbd.effects.speed_dependent_loss import SpeedDependentLoss
from torchrbd.effects.stribeck_friction import StribeckFriction
from torchrbd.effects.thermal_viscosity import ThermalViscosity
from torchrbd.effects.time_delay import TimeDelay
from torchrbd.effects.time_varying_friction import TimeVaryingFriction
from torchrbd.effects.torque_dead_zone import TorqueDeadZone
from torchrbd.effects.torque_offset import TorqueOffset
from torchrbd.effects.torque_ripple import TorqueRipple
from torchrbd.effects.torque_saturation import TorqueSaturation
from torchrbd.effects.torque_scale import TorqueScale
from torchrbd.effects.velocity_coupling import VelocityCoupling
from torchrbd.effects.viscous_friction import ViscousFriction
from torchrbd.errors import OptionError, closest

PLAIN = ("viscous_friction", "coulomb_friction", "torque_offset")
OF_DRIVES = "rotor_inertia"
"""Baseline friction, which is always fitted."""

_EFFECTS: dict[str, Effect] = {}
# Functions without a physical law: models may contain them, but they are not in the list of effects.
_UNNAMED: dict[str, Effect] = {smooth.id: smooth for smooth in (*SMOOTH, HUM)}


def register(effect: Effect) -> Effect:
    """Add an effect under its ``id`` to the search, the report and the export."""
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
    PreslidingHysteresis(),
    OneSidedSpring(),
    Counterbalance(),
    TorqueRipple(),
    TorqueScale(),
    TorqueSaturation(),
    TorqueDeadZone(),
    JointCoupling(),
    VelocityCoupling(),
    CoupledMotor(),
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


def tagged_effects() -> tuple[Effect, ...]:
    """Return the effects that URDF's <dynamics> has attributes for, see ``Effect.urdf_tag``."""
    return tuple(e for e in _EFFECTS.values() if e.urdf_tag)


def known_effects() -> dict[str, Effect]:
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
        hint = f"{closest(identifier, _EFFECTS)} ".lstrip()
        raise OptionError(f"unknown effect '{identifier}'; {hint}known: {', '.join(sorted(_EFFECTS))}")
    return _EFFECTS[identifier]
