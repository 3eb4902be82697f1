"""Statistics files: second moments of recordings, which add, in place of the recordings."""
