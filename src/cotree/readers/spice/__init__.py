"""Conversion of SPICE netlists to scenes."""
