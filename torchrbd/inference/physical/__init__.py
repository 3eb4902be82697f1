"""Physically valid fits: the prior around the URDF, linear and convex fits, their covariance, projections."""
