"""One file for each format of recordings; other packages offer theirs as entry points."""
