"""Conversion of SBML models to scenes."""
