"""Motion: models rolled forward from recorded states under recorded torque."""

from torchrbd.simulation.accuracy import COASTING, MotionError, Simulation, Spread, motion_errors

__all__ = ["COASTING", "MotionError", "Simulation", "Spread", "motion_errors"]
