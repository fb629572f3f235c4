"""Conversion of URDF robots to scenes."""
