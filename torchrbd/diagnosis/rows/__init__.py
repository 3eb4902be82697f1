"""The recordings as rows of one regression, whitened: what searching and locating look at."""
