"""Linear equations of nodes, or of a pattern alone: factors and solutions without any number."""
