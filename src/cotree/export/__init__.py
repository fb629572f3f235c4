"""From equations or a program to somewhere else: C projects, SymPy, LaTeX."""
