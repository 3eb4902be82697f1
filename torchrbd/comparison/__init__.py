"""What changed between two diagnoses of one robot, and how certain that is."""

from torchrbd.comparison.compare import compare
from torchrbd.comparison.results import Change, Comparison, Difference

__all__ = ["Change", "Comparison", "Difference", "compare"]
