"""What log evidence is worth: one monotone function of it, fitted on development arms.

A Gaussian likelihood with learnt noise is nearly right. On recordings that lack nothing the greatest log evidence plus
log prior odds of any hypothesis exceeds x in a part e^-x of them (100 simulations,
``benchmarks/results/null_evidence.json``): log odds are what exceeds the x that one in a hundred has.
"""

from __future__ import annotations

import math

OFFSET = math.log(100.0)


def calibrated(log_evidence: float) -> float:
    """Return the log Bayes factor that an evidence is worth."""
    return log_evidence - OFFSET
