"""What a rigid body leaves out: one file per effect, one contract, one registry."""

from torchrbd.physics.base import CoefficientPrior, Curve, Effect, JointEffect, Mjcf, Shape, Term
from torchrbd.physics.registry import effect, effects, register
from torchrbd.physics.signals import JointScale, JointState, Signals
from torchrbd.physics.sites import Site, Window

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
    "effects",
    "register",
]
