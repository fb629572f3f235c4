"""Studies of accuracy and speed, with many runs of one model."""
