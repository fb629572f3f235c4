"""Sensitivity graphs: topologically identical to the first, with differentiated terminal equations."""
