"""What counts as a difference: limits that decide what is reported and how."""

from __future__ import annotations

NO_CHANGE = 0.02
"""Relative change of a held-out error that cannot be distinguished from none."""
LIKELY = 0.5
"""Probability above which something is reported as found; below it is one of several candidates."""
SPRING_HELPS = 0.98
"""A spring is confirmed where it leaves less than this part of the deflection's held-out error."""
SPRING_SURE, SHORTEST_DELAY_S, INERTIAL_LOAD = 3.0, 1e-4, 0.5
"""Standard deviations from which a delay or lost motion is reported, the shortest delay, inertial part of a load."""
