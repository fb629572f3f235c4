"""URDF robots as scenes."""
