"""What is known after a fit: robots drawn from the posterior, predictive variance, what the data does not tell."""
