"""Scalar expression graphs: interned nodes, their derivatives and their evaluation."""
