"""One Gaussian likelihood of torques: what every machine has, noise, prior, and the evidence of anything more."""
