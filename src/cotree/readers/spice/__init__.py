"""SPICE netlists as scenes."""
