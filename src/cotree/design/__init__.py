"""Design: parameters for which an objective is least, and states in which a model is at rest."""
