"""Many runs of one model in one call: sweeps, Monte Carlo, starts of a fit."""
