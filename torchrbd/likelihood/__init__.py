"""A Gaussian likelihood of torques: baseline model, noise, prior, and the log evidence of additional terms."""
