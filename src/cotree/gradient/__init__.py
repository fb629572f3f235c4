"""Derivatives of objectives of runs in reverse mode."""
