"""Effects that a user tells, at their places, and the refinement of their nonlinear (shape) parameters."""
