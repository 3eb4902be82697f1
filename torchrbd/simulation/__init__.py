"""Motion: models rolled forward from recorded states under recorded torque, or under recorded set-points."""

from torchrbd.simulation.accuracy import COASTING, MotionError, MotionErrors, Spread, motion_errors
from torchrbd.simulation.closed_loop import ClosedLoop, closed_loop
from torchrbd.simulation.simulate import SimulatedMotion, check_suffix, simulate

__all__ = [
    "COASTING",
    "ClosedLoop",
    "MotionError",
    "MotionErrors",
    "SimulatedMotion",
    "Spread",
    "check_suffix",
    "closed_loop",
    "motion_errors",
    "simulate",
]
