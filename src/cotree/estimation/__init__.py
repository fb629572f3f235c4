"""Estimation of parameters from measurements, with intervals and optimal further measurements."""
