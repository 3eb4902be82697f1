"""What log evidence is worth: one monotone function of it, fitted on development arms.

A Gaussian likelihood with learnt noise is nearly right. Log odds are the evidence times a slope, less what the greatest
of all hypotheses of a recording that lacks nothing takes by chance.
"""

from __future__ import annotations

SLOPE, OFFSET = 1.0, 3.0


def calibrated(log_evidence: float) -> float:
    """Return the log Bayes factor that an evidence is worth."""
    return SLOPE * log_evidence - OFFSET
