"""The scalar language: interned nodes, their derivatives and their evaluation."""
