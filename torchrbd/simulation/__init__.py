"""Motion: models rolled forward from recorded states under recorded torque."""

from torchrbd.simulation.accuracy import COASTING, MotionError, MotionErrors, Spread, motion_errors
from torchrbd.simulation.simulate import SimulatedMotion, check_suffix, simulate

__all__ = [
    "COASTING",
    "MotionError",
    "MotionErrors",
    "SimulatedMotion",
    "Spread",
    "check_suffix",
    "motion_errors",
    "simulate",
]
