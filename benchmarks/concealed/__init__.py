"""A benchmark of cases whose physics is concealed: generator, scorer, rivals."""
