"""Diagnosis: what the rigid body leaves out, where, and how sure that is."""

from torchrbd.diagnosis.diagnose import diagnose
from torchrbd.diagnosis.diagnosis import Diagnosis
from torchrbd.diagnosis.ranked import Ranked, Ranking
from torchrbd.diagnosis.ranking import rank_hypotheses
from torchrbd.diagnosis.results import (
    Alternative,
    Attack,
    Curve,
    Deflection,
    DetectionLimit,
    Finding,
    Location,
    Quantity,
    Region,
    ResidualMap,
    Unexplained,
    Where,
)

__all__ = [
    "Alternative",
    "Attack",
    "Curve",
    "Deflection",
    "DetectionLimit",
    "Diagnosis",
    "Finding",
    "Location",
    "Quantity",
    "Ranked",
    "Ranking",
    "Region",
    "ResidualMap",
    "Unexplained",
    "Where",
    "diagnose",
    "rank_hypotheses",
]
