"""Estimation problems in the PEtab format, version 1."""
