"""Suspicions: what a table may mean instead of what it says, each tried as a hypothesis of how it was written."""

from torchrbd.inference.suspicions.late_torque import with_late_torque
from torchrbd.inference.suspicions.results import NO_SUSPICIONS, Suspicion, Suspicions
from torchrbd.inference.suspicions.search import suspicions

__all__ = ["NO_SUSPICIONS", "Suspicion", "Suspicions", "suspicions", "with_late_torque"]
