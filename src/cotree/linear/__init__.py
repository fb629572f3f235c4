"""Symbolic solution of linear equations whose entries are nodes, or known only by their pattern."""
