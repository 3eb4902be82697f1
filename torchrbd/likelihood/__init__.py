"""One Gaussian likelihood of torques: what every machine has, the noise, the prior, and the evidence of anything more."""
