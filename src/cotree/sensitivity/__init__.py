"""Sensitivity graphs: the topology of the first, with differentiated terminal equations."""
