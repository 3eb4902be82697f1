"""Physics that a rigid body lacks: one file per effect, one base class, one registry."""

from torchrbd.effects.base import CoefficientPrior, Curve, Effect, JointEffect, Mjcf, Shape, Term
from torchrbd.effects.registry import effect, known_effects, register
from torchrbd.effects.signals import JointScale, JointState, Signals
from torchrbd.effects.sites import Site, Window

__all__ = [
    "CoefficientPrior",
    "Curve",
    "Effect",
    "JointEffect",
    "JointScale",
    "JointState",
    "Mjcf",
    "Shape",
    "Signals",
    "Site",
    "Term",
    "Window",
    "effect",
    "known_effects",
    "register",
]
