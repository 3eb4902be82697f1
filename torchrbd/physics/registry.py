"""The list of known effects. A third party adds its own with ``register``."""

from __future__ import annotations

from torchrbd.errors import OptionError
from torchrbd.physics.base import Effect
from torchrbd.physics.coulomb_friction import AsymmetricCoulombFriction, CoulombFriction
from torchrbd.physics.joint_spring import JointSpring
from torchrbd.physics.rotor_inertia import RotorInertia
from torchrbd.physics.stribeck_friction import StribeckFriction
from torchrbd.physics.torque_offset import TorqueOffset
from torchrbd.physics.viscous_friction import ViscousFriction

_EFFECTS: dict[str, Effect] = {}


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
    if identifier not in _EFFECTS:
        raise OptionError(f"unknown effect '{identifier}'; known: {', '.join(sorted(_EFFECTS))}")
    return _EFFECTS[identifier]
