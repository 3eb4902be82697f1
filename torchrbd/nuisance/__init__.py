"""What every machine has, besides effects that a search looks for: one file, one equation, one prior each."""
