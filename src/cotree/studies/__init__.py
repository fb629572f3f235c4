"""Studies: many runs of one model."""
