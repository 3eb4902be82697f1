"""The commands, one file each: what they understand. What they do is imported when one of them is run."""
