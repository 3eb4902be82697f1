"""The dynamics model that is fitted, extended, exported, simulated and trained."""

from __future__ import annotations

from pathlib import Path

from torchrbd.model.conditions import OTHERS, Condition, Reported
from torchrbd.model.rigid_body_dynamics import RigidBodyDynamics
from torchrbd.model.starting import REST_WIDTH, described_terms, known_terms

load_model = RigidBodyDynamics.load


def save_model(model: RigidBodyDynamics, path: str | Path) -> None:
    """Write a model to a safetensors file, as ``model.save(path)``: numbers, URDF and terms, no code.

    Raises:
        RobotError: the robot was not made from a URDF.
    """
    model.save(path)


__all__ = [
    "OTHERS",
    "REST_WIDTH",
    "Condition",
    "Reported",
    "RigidBodyDynamics",
    "described_terms",
    "known_terms",
    "load_model",
    "save_model",
]
