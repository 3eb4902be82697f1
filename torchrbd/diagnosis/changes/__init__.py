"""What changed between two diagnoses of one robot, and how certain that is."""
