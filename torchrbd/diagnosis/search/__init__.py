"""Search for the terms that a model lacks, on the whitened rows of the recordings."""
