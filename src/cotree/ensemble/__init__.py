"""Ensembles: many runs of one model in one call, for sweeps, Monte Carlo studies and fits."""
