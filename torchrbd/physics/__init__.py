"""What a rigid body leaves out: one file per effect, one contract, one registry."""

from torchrbd.physics.base import Effect, JointEffect, Shape, Term
from torchrbd.physics.registry import effect, effects, register, searched_effects
from torchrbd.physics.signals import JointScale, JointState, Signals, Site, Window

__all__ = [
    "Effect",
    "JointEffect",
    "JointScale",
    "JointState",
    "Shape",
    "Signals",
    "Site",
    "Term",
    "Window",
    "effect",
    "effects",
    "register",
    "searched_effects",
]
