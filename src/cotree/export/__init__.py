"""Export of equations and programs: C projects, SymPy, LaTeX."""
