"""C text from a program: nodes to expressions, expressions into templates."""
