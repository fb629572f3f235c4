"""SBML models as scenes."""
