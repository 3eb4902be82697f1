"""What a rigid body leaves out: one file per effect, one contract, one registry."""

from torchrbd.physics.base import Effect, JointScale, JointState, Shape, Term
from torchrbd.physics.registry import effect, effects, register

__all__ = ["Effect", "JointScale", "JointState", "Shape", "Term", "effect", "effects", "register"]
