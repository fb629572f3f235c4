"""Estimation: from measurements to parameters, their intervals and the next measurement."""
