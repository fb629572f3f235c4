"""Sensitivity graphs: the topology of the first graph with differentiated terminal equations."""
