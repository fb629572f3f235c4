"""Symbolic solution of linear equations: of nodes, or of a sparsity pattern."""
