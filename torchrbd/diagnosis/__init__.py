"""Diagnosis: what the rigid body leaves out, where, and how sure that is."""

from torchrbd.diagnosis.diagnose import diagnose
from torchrbd.diagnosis.results import (
    Alternative,
    Attack,
    Curve,
    Diagnosis,
    Finding,
    LeftoverMap,
    Location,
    Quantity,
    Region,
    Unexplained,
    Where,
)

__all__ = [
    "Alternative",
    "Attack",
    "Curve",
    "Diagnosis",
    "Finding",
    "LeftoverMap",
    "Location",
    "Quantity",
    "Region",
    "Unexplained",
    "Where",
    "diagnose",
]
