"""Many robots side by side: who differs from its sisters, and what changed since an earlier time."""

from torchrbd.fleet.compare import compare_fleet
from torchrbd.fleet.results import FleetComparison, MemberResult

__all__ = ["FleetComparison", "MemberResult", "compare_fleet"]
