"""Effects that a user requests, at their places, and the refinement of their nonlinear (shape) parameters."""
