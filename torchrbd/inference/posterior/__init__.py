"""What is known after a fit: robots drawn from the posterior, predictive variance, parameters not identified."""
